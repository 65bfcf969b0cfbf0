//! Scatter charts of quality over cost: one point per method with its spread, and the Pareto front.

use maud::{Markup, html};

use super::plot::{HEIGHT, Labels, Plot};
use super::{Panel, WIDTH, colour, marker, text};

/// A chart of points.
pub(crate) struct Scatter {
    /// Title.
    pub title: String,
    /// Quantity and unit of the x axis.
    pub x_label: String,
    /// Quantity and unit of the y axis; higher is better.
    pub y_label: String,
    /// The points.
    pub points: Vec<Point>,
}

/// One method.
pub(crate) struct Point {
    /// Index of colour and marker; the number in the legend is `style` + 1.
    pub style: usize,
    /// Cost and quality.
    pub at: [f64; 2],
    /// Standard deviations over seeds; 0 for a single seed.
    pub std: [f64; 2],
    /// Cost and quality of every seed.
    pub seeds: Vec<[f64; 2]>,
    /// Whether the point is on the Pareto front: no other point is better in one value and at least as good in the
    /// other.
    pub on_front: bool,
}

impl Scatter {
    /// The chart as a panel; the cost axis is logarithmic.
    pub(crate) fn panel(self) -> Panel {
        let extent: Vec<[f64; 2]> = self.points.iter().flat_map(Point::extent).collect();
        let plot = Plot::new(&extent, true);
        let labels = Labels { title: &self.title, x: &self.x_label, y: &self.y_label };
        let mut front: Vec<[f64; 2]> =
            self.points.iter().filter(|point| point.on_front).map(|point| point.at).collect();
        front.sort_by(|a, b| a[0].total_cmp(&b[0]));
        let front: Vec<String> = front.iter().map(|point| plot.at(*point)).collect();
        let drawing = html! {
            (plot.frame(&labels))
            @if !front.is_empty() {
                path class="axis" d=(format!("M{}", front.join("L"))) stroke-dasharray="1 3" {}
            }
            @for point in &self.points { (point.draw(&plot)) }
            (numbers(&self.points, &plot))
        };
        Panel { title: self.title, width: WIDTH, height: HEIGHT, drawing }
    }
}

impl Point {
    fn extent(&self) -> Vec<[f64; 2]> {
        let ([x, y], [dx, dy]) = (self.at, self.std);
        [[x, y - dy], [x, y + dy], [(x - dx).max(x / 2.0), y], [x + dx, y]]
            .into_iter()
            .chain(self.seeds.clone())
            .collect()
    }

    fn draw(&self, plot: &Plot) -> Markup {
        let ([x, y], [dx, dy]) = (self.at, self.std);
        let cross = [[[x, y - dy], [x, y + dy]], [[(x - dx).max(x / 2.0), y], [x + dx, y]]];
        let lines = cross.map(|[from, to]| format!("M{}L{}", plot.at(from), plot.at(to))).concat();
        html! {
            @if dx > 0.0 || dy > 0.0 { path d=(lines) stroke=(colour(self.style)) stroke-width="1.2" {} }
            @for seed in &self.seeds {
                @let [x, y] = plot.place(*seed);
                circle cx=(format!("{x:.1}")) cy=(format!("{y:.1}")) r="1.3" fill=(colour(self.style)) {}
            }
            (marker(self.style, plot.place(self.at), self.on_front))
        }
    }
}

/// A number next to each point, on the first side where it touches no other point and no other number.
fn numbers(points: &[Point], plot: &Plot) -> Markup {
    const SIDES: [[f64; 2]; 6] = [[10.0, 4.0], [-10.0, 4.0], [0.0, -8.0], [0.0, 16.0], [11.0, -6.0], [-11.0, 14.0]];
    let mut taken: Vec<[f64; 2]> = points.iter().map(|point| plot.place(point.at)).collect();
    let mut placed = Vec::new();
    for point in points {
        let [x, y] = plot.place(point.at);
        let free = |[dx, dy]: &[f64; 2]| {
            // The centre of a number lies 4 px above its baseline.
            let touches = |[tx, ty]: &[f64; 2]| (x + dx - tx).abs() < 9.0 && (y + dy - 4.0 - ty).abs() < 9.0;
            !taken.iter().filter(|at| **at != [x, y]).any(touches)
        };
        let [dx, dy] = SIDES.into_iter().find(free).unwrap_or(SIDES[0]);
        taken.push([x + dx, y + dy - 4.0]);
        placed.push(text([x + dx, y + dy], "middle", &(point.style + 1).to_string()));
    }
    html! { @for number in placed { (number) } }
}
