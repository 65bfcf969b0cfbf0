//! Typesets a figure as a standalone SVG file.

use maud::{PreEscaped, html};

use crate::document::{Figure, Key};
use crate::svg::{Panel, SAMPLE};

/// Number of panels and of legend entries per line.
const COLUMNS: usize = 3;
/// Height of a legend line, px.
const LINE: f64 = 20.0;

/// Style of texts, grids and axes; the HTML page has its own style sheet.
const STYLE: &str = "text{font:12px Helvetica,Arial,sans-serif;fill:#222}.title{font-weight:bold}.grid{stroke:#ddd;fill:none}\
.axis{stroke:#555;fill:none}";

/// The figure as an SVG file: panels in rows, the legend below them.
pub(crate) fn file(figure: &Figure) -> String {
    let columns = figure.panels.len().clamp(1, COLUMNS);
    let cell = |measure: fn(&Panel) -> f64| figure.panels.iter().map(measure).fold(0.0, f64::max);
    let (panel_width, panel_height) = (cell(|panel| panel.width), cell(|panel| panel.height));
    let plots = panel_height * figure.panels.len().div_ceil(columns) as f64;
    let width = panel_width * columns as f64;
    let height = plots + LINE * figure.legend.len().div_ceil(columns) as f64 + 8.0;
    let spot = |at: usize, row_height: f64| (panel_width * (at % columns) as f64, row_height * (at / columns) as f64);
    let entry = |at: usize, key: &Key| {
        let (x, y) = spot(at, LINE);
        html! {
            g transform=(format!("translate({} {})", x + 8.0, y + plots)) {
                (key.sample)
                text x=(SAMPLE[0] + 8.0) y="11" { (key.text()) }
            }
        }
    };
    let markup = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox=(format!("0 0 {width} {height}")) width=(width) height=(height) {
            style { (PreEscaped(STYLE)) }
            rect width=(width) height=(height) fill="#fff" {}
            @for (at, panel) in figure.panels.iter().enumerate() {
                @let (x, y) = spot(at, panel_height);
                g transform=(format!("translate({x} {y})")) { (panel.drawing) }
            }
            @for (at, key) in figure.legend.iter().enumerate() { (entry(at, key)) }
        }
    };
    markup.into_string() + "\n"
}
