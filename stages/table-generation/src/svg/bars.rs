//! Stacked horizontal bars: one bar per row, one segment per part of the total.

use maud::html;

use super::plot::{linear_ticks, tick_decimals};
use super::{Panel, WIDTH, area, colour, text};
use crate::format::number;

// Height of a row and of its bar, and edges of the plot, px.
const ROW: f64 = 37.0;
const BAR: f64 = 14.0;
const LEFT: f64 = 4.0;
const RIGHT: f64 = WIDTH - 16.0;
const TOP: f64 = 26.0;
/// Smallest width of a segment that shows its number, px.
const NUMBERED: f64 = 14.0;

/// A chart of bars.
pub(crate) struct Bars {
    /// Title.
    pub title: String,
    /// Quantity and unit of the lengths.
    pub x_label: String,
    /// Label and segment lengths of each bar; a segment's number in the legend is its index + 1.
    pub rows: Vec<(String, Vec<f64>)>,
}

impl Bars {
    /// The chart as a panel.
    pub(crate) fn panel(self) -> Panel {
        let longest = self.rows.iter().map(|(_, segments)| segments.iter().sum::<f64>()).fold(0.0, f64::max);
        let scale = (RIGHT - LEFT) / longest.max(f64::MIN_POSITIVE);
        let bottom = TOP + ROW * self.rows.len() as f64;
        let ticks = if longest > 0.0 { linear_ticks(0.0, longest) } else { Vec::new() };
        let decimals = tick_decimals(&ticks);
        let drawing = html! {
            text x="4" y="16" class="title" { (self.title) }
            @for &tick in &ticks {
                @let at = LEFT + tick * scale;
                path class="grid" d=(format!("M{} {TOP}V{bottom}", number(at, 1))) {}
                (text([at.max(8.0), bottom + 14.0], "middle", &number(tick, decimals)))
            }
            @for (row, (label, segments)) in self.rows.iter().enumerate() {
                @let y = TOP + ROW * row as f64;
                (text([LEFT, y + 14.0], "start", &format!("{label}: {}", number(segments.iter().sum(), 1))))
                @for (at, (start, length)) in starts(segments).enumerate().filter(|(_, (_, length))| *length > 0.0) {
                    @let x = LEFT + start * scale;
                    (area(at, [x, y + 19.0], [length * scale, BAR]))
                    @if length * scale >= NUMBERED {
                        text x=(number(x + length * scale / 2.0, 1)) y=(y + 30.0) text-anchor="middle" fill="#000"
                            stroke=(colour(at)) stroke-width="3" paint-order="stroke" class="on-colour" { (at + 1) }
                    }
                }
            }
            (text([(LEFT + RIGHT) / 2.0, bottom + 31.0], "middle", &self.x_label))
        };
        Panel { title: self.title, width: WIDTH, height: bottom + 38.0, drawing }
    }
}

/// Start and length of every segment, in the unit of the data.
fn starts(segments: &[f64]) -> impl Iterator<Item = (f64, f64)> {
    segments.iter().scan(0.0, |end, length| {
        let start = *end;
        *end += length;
        Some((start, *length))
    })
}
