// One launch over ITEMS items. Each item has its own constants, arrays and run of consecutive workgroups.
#const ITEMS, ITEM_BYTES
#extern struct Item

const VECTORS: u32 = (ITEMS + 3u) / 4u;

// The constants of an item, padded to ITEM_BYTES.
struct Padded {
    @size(ITEM_BYTES) constants: Item,
}

struct Grouped {
    // The first workgroup of every item, four to a vector.
    first_groups: array<vec4<u32>, VECTORS>,
    items: array<Padded, ITEMS>,
}

@group(0) @binding(0) var<uniform> grouped: Grouped;

fn constants_of(item: u32) -> Item {
    return grouped.items[item].constants;
}

fn first_group(item: u32) -> u32 {
    return grouped.first_groups[item / 4u][item % 4u];
}

// The item of a workgroup: the last one whose first workgroup is at or before it.
fn item_of(group: u32) -> u32 {
    var item = 0u;
    var beyond = ITEMS;
    while (beyond - item > 1u) {
        let middle = (item + beyond) / 2u;
        if (first_group(middle) <= group) {
            item = middle;
        } else {
            beyond = middle;
        }
    }
    return item;
}
