// A part of joined rows: its leading columns are side by side with those of other parts.

struct Item {
    rows: u32,
    // Columns of the part, and how many of them are in the joined rows.
    columns: u32,
    width: u32,
    // Columns of the joined rows, and where those of the part begin.
    joined_columns: u32,
    first: u32,
}
