//! Quality over something: a line per method, with a band where there are several seeds.

use maud::{Markup, html};

use super::plot::{HEIGHT, Labels, Plot};
use super::{Panel, WIDTH, colour, dash, marker};

/// Markers per line: enough to tell lines apart without hiding them.
const MARKERS: usize = 6;

/// A chart of lines.
pub struct Lines {
    /// What it shows.
    pub title: String,
    /// What runs to the right, with its unit.
    pub x_label: String,
    /// What runs upwards, with its unit.
    pub y_label: String,
    /// Whether x is logarithmic.
    pub log_x: bool,
    /// The lines.
    pub series: Vec<Series>,
}

/// One line.
pub struct Series {
    /// Chooses colour, dashes and marker; its number in the legend is one more.
    pub style: usize,
    /// x, and the lowest, middle and highest y there; x ascending.
    pub points: Vec<(f64, [f64; 3])>,
    /// Whether to fill between lowest and highest.
    pub has_band: bool,
    /// A single point that belongs to the line but was measured otherwise.
    pub mark: Option<[f64; 2]>,
}

impl Lines {
    /// The chart as a panel.
    pub fn panel(self) -> Panel {
        let plot = Plot::new(&self.extent(), self.log_x);
        let labels = Labels { title: &self.title, x: &self.x_label, y: &self.y_label };
        let end = |series: &Series| series.points.last().map(|(_, [_, middle, _])| (series.style, *middle));
        let drawing = html! {
            (plot.frame(&labels))
            @for series in &self.series { (series.draw(&plot)) }
            (plot.end_numbers(self.series.iter().filter_map(end)))
        };
        Panel { title: self.title, width: WIDTH, height: HEIGHT, drawing }
    }

    /// All that must be seen.
    fn extent(&self) -> Vec<[f64; 2]> {
        let edges = |series: &Series| -> Vec<[f64; 2]> {
            series.points.iter().flat_map(|(x, [low, _, high])| [[*x, *low], [*x, *high]]).chain(series.mark).collect()
        };
        self.series.iter().flat_map(edges).collect()
    }
}

impl Series {
    fn draw(&self, plot: &Plot) -> Markup {
        let points: Vec<_> = self.points.iter().filter(|(x, _)| plot.holds(*x)).collect();
        let middle: Vec<[f64; 2]> = points.iter().map(|(x, [_, middle, _])| [*x, *middle]).collect();
        let low = points.iter().map(|(x, [low, _, _])| plot.at([*x, *low]));
        let high = points.iter().rev().map(|(x, [_, _, high])| plot.at([*x, *high]));
        let outline: Vec<String> = low.chain(high).collect();
        let line: Vec<String> = middle.iter().map(|point| plot.at(*point)).collect();
        let every = middle.len().div_ceil(MARKERS).max(1);
        html! {
            @if self.has_band {
                path d=(format!("M{}Z", outline.join("L"))) fill=(colour(self.style)) opacity="0.15" {}
            }
            path d=(format!("M{}", line.join("L"))) fill="none" stroke=(colour(self.style)) stroke-width="1.8"
                stroke-dasharray=(dash(self.style)) {}
            @for point in middle.iter().step_by(every) { (marker(self.style, plot.place(*point), false)) }
            @if let Some(mark) = self.mark { (marker(self.style, plot.place(mark), true)) }
        }
    }
}
