//! Values along an axis as strips of colour, one strip per row, so that a whole sequence is seen at once.

use maud::html;

use super::{Panel, WIDTH, hex, text};
use crate::format::number;

/// A row's height, that of its strip, and the edges of the plot, px.
const ROW: f64 = 34.0;
const STRIP: f64 = 13.0;
const LEFT: f64 = 4.0;
const RIGHT: f64 = WIDTH - 8.0;
const TOP: f64 = 24.0;

/// The scale of the strips: its lightness rises steadily, for every kind of colour vision and in grey.
pub const SCALE: colorous::Gradient = colorous::CIVIDIS;

/// A chart of strips.
pub struct Strips {
    /// What it shows.
    pub title: String,
    /// What runs to the right, as the texts below its ends.
    pub ends: [String; 2],
    /// The values that the darkest and the lightest colour stand for.
    pub range: [f64; 2],
    /// Label and cells of each strip: what a pointer resting on a cell is told, and its value.
    pub rows: Vec<(String, Vec<(String, f64)>)>,
}

impl Strips {
    /// The chart as a panel.
    pub fn panel(self) -> Panel {
        let [low, high] = self.range;
        let share = |value: f64| if high > low { (value - low) / (high - low) } else { 0.5 };
        let bottom = TOP + ROW * self.rows.len() as f64;
        let drawing = html! {
            text x="4" y="16" class="title" { (self.title) }
            @for (row, (label, cells)) in self.rows.iter().enumerate() {
                @let (y, width) = (TOP + ROW * row as f64, (RIGHT - LEFT) / cells.len().max(1) as f64);
                (text([LEFT, y + 13.0], "start", label))
                @for (at, (told, value)) in cells.iter().enumerate() {
                    rect x=(number(LEFT + at as f64 * width, 1)) y=(y + 17.0) width=(number(width + 0.2, 1))
                        height=(STRIP) fill=(hex(SCALE, share(*value))) { title { (told) } }
                }
            }
            (text([LEFT, bottom + 12.0], "start", &self.ends[0]))
            (text([RIGHT, bottom + 12.0], "end", &self.ends[1]))
        };
        Panel { title: self.title, width: WIDTH, height: bottom + 18.0, drawing }
    }
}
