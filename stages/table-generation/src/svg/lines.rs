//! Line charts: one line of steps per method, with a band for several seeds.

use maud::{Markup, html};

use super::plot::{HEIGHT, Labels, Plot};
use super::{Panel, WIDTH, colour, dash, marker};

/// Number of markers per line: enough to distinguish lines, few enough not to hide them.
const MARKERS: usize = 6;

/// A chart of lines.
pub(crate) struct Lines {
    /// Title.
    pub title: String,
    /// Quantity and unit of the x axis.
    pub x_label: String,
    /// Quantity and unit of the y axis.
    pub y_label: String,
    /// Whether the x axis is logarithmic.
    pub log_x: bool,
    /// The lines.
    pub series: Vec<Series>,
}

/// One line.
pub(crate) struct Series {
    /// Index of colour, dashes and marker; the number in the legend is `style` + 1.
    pub style: usize,
    /// Points as x and [lowest, middle, highest] y, in ascending order of x. The line is level up to the next point, and a thin
    /// line continues the last point up to the right edge, where its number stands.
    pub points: Vec<(f64, [f64; 3])>,
    /// Whether the area between lowest and highest is filled.
    pub has_band: bool,
    /// A related point from another measurement, drawn as a filled marker.
    pub mark: Option<[f64; 2]>,
}

impl Lines {
    /// The chart as a panel.
    pub(crate) fn panel(self) -> Panel {
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

    /// All points that the plot must contain.
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
        let of = |edge: usize| steps(points.iter().map(|(x, values)| [*x, values[edge]]));
        let text =
            |corners: Vec<[f64; 2]>| -> Vec<String> { corners.into_iter().map(|point| plot.at(point)).collect() };
        let outline = text(of(0).into_iter().chain(of(2).into_iter().rev()).collect());
        let line = text(of(1));
        let every = middle.len().div_ceil(MARKERS).max(1);
        html! {
            @if self.has_band {
                path d=(format!("M{}Z", outline.join("L"))) fill=(colour(self.style)) opacity="0.15" {}
            }
            path d=(format!("M{}", line.join("L"))) fill="none" stroke=(colour(self.style)) stroke-width="1.8"
                stroke-dasharray=(dash(self.style)) {}
            @if let Some(last) = middle.last() {
                path class="kept" d=(plot.to_the_end(*last)) fill="none" stroke=(colour(self.style)) stroke-width="0.7" {}
            }
            @for point in middle.iter().step_by(every) { (marker(self.style, plot.place(*point), false)) }
            @if let Some(mark) = self.mark { (marker(self.style, plot.place(mark), true)) }
        }
    }
}

/// The corners of a line that is level up to each next point.
fn steps(points: impl Iterator<Item = [f64; 2]>) -> Vec<[f64; 2]> {
    let mut corners: Vec<[f64; 2]> = Vec::new();
    for [x, y] in points {
        let level = corners.last().map(|[_, before]| [x, *before]);
        corners.extend(level.into_iter().chain([[x, y]]));
    }
    corners
}
