//! Line charts as SVG: direct labels, dashes and markers so that no line depends on its colour, light background.

use std::fmt::Write as _;

use crate::format::number;

/// A panel's height, the edges of its plot, and what lies around it, in px.
const HEIGHT: f64 = 330.0;
const LEFT: f64 = 58.0;
const RIGHT: f64 = 400.0;
const TOP: f64 = 34.0;
const BOTTOM: f64 = HEIGHT - 46.0;
/// Room to the right of the plot: marker and value of a label, and each character of its name (12 px sans-serif).
const LABEL_WIDTH: f64 = 70.0;
const CHARACTER_WIDTH: f64 = 7.0;
/// Baseline distance at which two labels do not touch.
const LABEL_STEP: f64 = 14.0;
/// Markers per line: enough to tell lines apart without hiding them.
const MARKERS: usize = 7;
/// Panels side by side.
const COLUMNS: usize = 2;

/// Okabe and Ito's palette, which stays distinct for colour-blind readers; yellow is left out on white.
const COLOURS: [&str; 7] = ["#0072b2", "#d55e00", "#009e73", "#cc79a7", "#000000", "#e69f00", "#56b4e9"];
const DASHES: [&str; 5] = ["none", "7 3", "2 3", "9 3 2 3", "4 2"];

/// One chart.
pub struct Panel {
    /// Escaped title.
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
    /// Escaped label.
    pub label: String,
    /// Chooses colour, dashes and marker.
    pub style: usize,
    /// x, and the lowest, middle and highest y there; x ascending.
    pub points: Vec<(f64, [f64; 3])>,
    /// Whether to fill between lowest and highest.
    pub has_band: bool,
}

/// Panels side by side in one picture.
pub fn grid(panels: &[&Panel]) -> String {
    let columns = panels.len().clamp(1, COLUMNS);
    let rows = panels.len().div_ceil(columns).max(1);
    let panel_width = panels.iter().map(|panel| panel.width()).fold(RIGHT, f64::max);
    let (width, height) = (panel_width * columns as f64, HEIGHT * rows as f64);
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 {width} {height}\" width=\"{width}\" \
         height=\"{height}\" font-family=\"Helvetica, Arial, sans-serif\" font-size=\"12\" fill=\"#222\">\n\
         <rect width=\"{width}\" height=\"{height}\" fill=\"#fff\"/>\n"
    );
    for (i, panel) in panels.iter().enumerate() {
        let (x, y) = (panel_width * (i % columns) as f64, HEIGHT * (i / columns) as f64);
        svg += &format!("<g transform=\"translate({x} {y})\">\n{}</g>\n", panel.draw());
    }
    if panels.is_empty() {
        svg += &format!("<text x=\"{}\" y=\"40\">no run recorded a curve</text>\n", LEFT);
    }
    svg + "</svg>\n"
}

/// Data to pixels on one axis.
struct Axis {
    from: [f64; 2],
    to: [f64; 2],
    is_log: bool,
    ticks: Vec<f64>,
}

impl Axis {
    /// An axis with ticks at round values between `low` and `high`.
    fn new(low: f64, high: f64, to: [f64; 2], is_log: bool) -> Self {
        let ticks = if is_log { log_ticks(low, high) } else { linear_ticks(low, high) };
        Self { from: if is_log { [low.log10(), high.log10()] } else { [low, high] }, to, is_log, ticks }
    }

    fn pixel(&self, value: f64) -> f64 {
        let value = if self.is_log { value.log10() } else { value };
        self.to[0] + (value - self.from[0]) / (self.from[1] - self.from[0]) * (self.to[1] - self.to[0])
    }
}

impl Panel {
    /// Outer width: the plot and the longest label.
    fn width(&self) -> f64 {
        let longest = self.series.iter().map(|series| series.label.chars().count()).max().unwrap_or(0);
        RIGHT + LABEL_WIDTH + CHARACTER_WIDTH * longest as f64
    }

    fn draw(&self) -> String {
        let (x, y) = self.axes();
        let mut svg = self.frame(&x, &y);
        for series in &self.series {
            svg += &series.draw(&x, &y, self.log_x);
        }
        svg + &self.labels(&y)
    }

    /// Axes that hold every point; y has some air above and below.
    fn axes(&self) -> (Axis, Axis) {
        let is_drawn = |(x, _): &&(f64, [f64; 3])| !self.log_x || *x > 0.0;
        let points = || self.series.iter().flat_map(|series| &series.points).filter(is_drawn);
        let xs = || points().map(|(x, _)| *x);
        let ys = || points().flat_map(|(_, [low, _, high])| [*low, *high]);
        let range = |low: f64, high: f64| if high > low { (low, high) } else { (low - 0.5, low + 0.5) };
        let x_high = xs().fold(0.0, f64::max).max(f64::MIN_POSITIVE);
        let x_low = if self.log_x { xs().fold(f64::INFINITY, f64::min).min(x_high / 2.0) } else { 0.0 };
        let (y_low, y_high) = range(ys().fold(f64::INFINITY, f64::min), ys().fold(f64::NEG_INFINITY, f64::max));
        let air = 0.05 * (y_high - y_low);
        let x = Axis::new(x_low, x_high, [LEFT, RIGHT], self.log_x);
        (x, Axis::new(y_low - air, y_high + air, [BOTTOM, TOP], false))
    }

    /// Title, grid, ticks and axis labels.
    fn frame(&self, x: &Axis, y: &Axis) -> String {
        let mut svg = format!("<text x=\"{LEFT}\" y=\"20\" font-weight=\"bold\">{}</text>\n", self.title);
        for &tick in &y.ticks {
            let at = number(y.pixel(tick), 1);
            writeln!(svg, "<path d=\"M{LEFT} {at}H{RIGHT}\" stroke=\"#e3e3e3\"/>").expect("string");
            let text = tick_text(tick, &y.ticks);
            let x = LEFT - 7.0;
            writeln!(svg, "<text x=\"{x}\" y=\"{at}\" dy=\"4\" text-anchor=\"end\">{text}</text>").expect("string");
        }
        for &tick in &x.ticks {
            let at = number(x.pixel(tick), 1);
            writeln!(svg, "<path d=\"M{at} {TOP}V{BOTTOM}\" stroke=\"#e3e3e3\"/>").expect("string");
            let text = tick_text(tick, &x.ticks);
            let y = BOTTOM + 16.0;
            writeln!(svg, "<text x=\"{at}\" y=\"{y}\" text-anchor=\"middle\">{text}</text>").expect("string");
        }
        writeln!(svg, "<path d=\"M{LEFT} {TOP}V{BOTTOM}H{RIGHT}\" fill=\"none\" stroke=\"#555\"/>").expect("string");
        let (middle_x, middle_y) = ((LEFT + RIGHT) / 2.0, (TOP + BOTTOM) / 2.0);
        let below = BOTTOM + 36.0;
        let x_label = &self.x_label;
        writeln!(svg, "<text x=\"{middle_x}\" y=\"{below}\" text-anchor=\"middle\">{x_label}</text>").expect("string");
        svg + &format!(
            "<text transform=\"translate(15 {middle_y}) rotate(-90)\" text-anchor=\"middle\">{}</text>\n",
            self.y_label
        )
    }

    /// Names and last values at the ends of the lines, pushed apart where they would overlap.
    fn labels(&self, y: &Axis) -> String {
        let end = |series: &Series| series.points.last().map(|(_, [_, middle, _])| *middle);
        let mut labels: Vec<(f64, &Series, f64)> =
            self.series.iter().filter_map(|s| end(s).map(|value| (y.pixel(value), s, value))).collect();
        labels.sort_by(|a, b| a.0.total_cmp(&b.0));
        for i in 1..labels.len() {
            labels[i].0 = labels[i].0.max(labels[i - 1].0 + LABEL_STEP);
        }
        // Labels that were pushed below the plot move up together.
        let overshoot = labels.last().map_or(0.0, |last| (last.0 - y.to[0]).max(0.0));
        let x = RIGHT + 12.0;
        let text = |(at, series, value): &(f64, &Series, f64)| {
            let marker = marker(series.style, x, at - overshoot);
            let (at, after, label) = (number(at - overshoot, 1), x + 9.0, &series.label);
            format!("{marker}<text x=\"{after}\" y=\"{at}\" dy=\"4\">{label} {}</text>\n", number(*value, 1))
        };
        labels.iter().map(text).collect()
    }
}

impl Series {
    fn draw(&self, x: &Axis, y: &Axis, log_x: bool) -> String {
        let points: Vec<_> = self.points.iter().filter(|(seconds, _)| !log_x || *seconds > 0.0).collect();
        let place = |seconds: f64, value: f64| format!("{} {}", number(x.pixel(seconds), 1), number(y.pixel(value), 1));
        let (colour, dash) = (colour(self.style), DASHES[self.style % DASHES.len()]);
        let mut svg = String::new();
        if self.has_band {
            let low = points.iter().map(|(seconds, [low, _, _])| place(*seconds, *low));
            let high = points.iter().rev().map(|(seconds, [_, _, high])| place(*seconds, *high));
            let outline: Vec<String> = low.chain(high).collect();
            writeln!(svg, "<path d=\"M{}Z\" fill=\"{colour}\" opacity=\"0.15\"/>", outline.join("L")).expect("string");
        }
        let line: Vec<String> = points.iter().map(|(seconds, [_, middle, _])| place(*seconds, *middle)).collect();
        let stroke = format!("stroke=\"{colour}\" stroke-width=\"1.8\" stroke-dasharray=\"{dash}\"");
        writeln!(svg, "<path d=\"M{}\" fill=\"none\" {stroke}/>", line.join("L")).expect("string");
        let every = points.len().div_ceil(MARKERS).max(1);
        for (seconds, [_, middle, _]) in points.iter().step_by(every) {
            svg += &marker(self.style, x.pixel(*seconds), y.pixel(*middle));
        }
        svg
    }
}

fn colour(style: usize) -> &'static str {
    COLOURS[style % COLOURS.len()]
}

/// A circle, square, triangle, diamond or cross around a point.
fn marker(style: usize, x: f64, y: f64) -> String {
    let shape = match style % 5 {
        0 => "M-3.5 0a3.5 3.5 0 1 0 7 0a3.5 3.5 0 1 0 -7 0Z",
        1 => "M-3 -3H3V3H-3Z",
        2 => "M0 -4L4 3H-4Z",
        3 => "M0 -4.5L4 0L0 4.5L-4 0Z",
        _ => "M-3 -3L3 3M3 -3L-3 3",
    };
    let (x, y, colour) = (number(x, 1), number(y, 1), colour(style));
    format!(
        "<path transform=\"translate({x} {y})\" d=\"{shape}\" fill=\"#fff\" stroke=\"{colour}\" stroke-width=\"1.6\"/>\n"
    )
}

/// Four to eight multiples of 1, 2 or 5 times a power of ten.
fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    let magnitude = 10.0_f64.powf(((high - low) / 5.0).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * magnitude);
    let step = steps.into_iter().find(|step| (high - low) / step <= 7.0).unwrap_or(steps[3]);
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last).map(|i| i as f64 * step).collect()
}

/// 1, 2 and 5 times the powers of ten; powers alone where that would be crowded.
fn log_ticks(low: f64, high: f64) -> Vec<f64> {
    let powers = low.log10().floor() as i32..=high.log10().ceil() as i32;
    let factors: &[f64] = if high / low > 1000.0 { &[1.0] } else { &[1.0, 2.0, 5.0] };
    let ticks = powers.flat_map(|power| factors.iter().map(move |factor| factor * 10.0_f64.powi(power)));
    ticks.filter(|tick| (low..=high).contains(tick)).collect()
}

/// As many decimals as tell neighbouring ticks apart.
fn tick_text(tick: f64, ticks: &[f64]) -> String {
    let step = ticks.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
    let decimals = if step.is_finite() { (-step.log10().floor()).clamp(0.0, 6.0) as usize } else { 0 };
    number(tick, decimals)
}
