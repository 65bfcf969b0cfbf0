//! Strips of colour, one per row, that show the values of a whole sequence at once.

use maud::html;

use super::{Panel, WIDTH, hex, text};
use crate::format::number;

// Height of a row and of its strip, and edges of the plot, px.
const ROW: f64 = 34.0;
const STRIP: f64 = 13.0;
const LEFT: f64 = 4.0;
const RIGHT: f64 = WIDTH - 8.0;
const TOP: f64 = 24.0;

/// Colour scale of the strips; its lightness increases monotonically, for all types of colour vision and in greyscale.
pub(crate) const SCALE: colorous::Gradient = colorous::CIVIDIS;

/// A chart of strips.
pub(crate) struct Strips {
    /// Title.
    pub title: String,
    /// Labels below the left and the right end of the axis.
    pub ends: [String; 2],
    /// Values of the darkest and of the lightest colour.
    pub range: [f64; 2],
    /// Label and cells of each strip; a cell is a tooltip and a value.
    pub rows: Vec<(String, Vec<(String, f64)>)>,
}

impl Strips {
    /// The chart as a panel.
    pub(crate) fn panel(self) -> Panel {
        let [low, high] = self.range;
        let share = |value: f64| if high > low { (value - low) / (high - low) } else { 0.5 };
        let bottom = TOP + ROW * self.rows.len() as f64;
        let drawing = html! {
            text x="4" y="16" class="title" { (self.title) }
            @for (row, (label, cells)) in self.rows.iter().enumerate() {
                @let (y, width) = (TOP + ROW * row as f64, (RIGHT - LEFT) / cells.len().max(1) as f64);
                (text([LEFT, y + 13.0], "start", label))
                @for (at, (tooltip, value)) in cells.iter().enumerate() {
                    rect x=(number(LEFT + at as f64 * width, 1)) y=(y + 17.0) width=(number(width + 0.2, 1))
                        height=(STRIP) fill=(hex(SCALE, share(*value))) { title { (tooltip) } }
                }
            }
            (text([LEFT, bottom + 12.0], "start", &self.ends[0]))
            (text([RIGHT, bottom + 12.0], "end", &self.ends[1]))
        };
        Panel { title: self.title, width: WIDTH, height: bottom + 18.0, drawing }
    }
}
