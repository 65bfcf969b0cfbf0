//! The coordinate system of charts: axes, ticks, grid, and labels that do not overlap.

use maud::{Markup, html};

use super::{WIDTH, text};
use crate::format::number;

/// Height of a panel, px.
pub(crate) const HEIGHT: f64 = 250.0;
// Edges of the plot, px. The numbers of lines need space at the right; the left edge depends on the ticks.
const RIGHT: f64 = WIDTH - 24.0;
const TOP: f64 = 30.0;
const BOTTOM: f64 = HEIGHT - 42.0;
/// Smallest vertical distance of two numbers that do not touch, px.
const LABEL_STEP: f64 = 12.0;
/// Baseline of the label of the y axis, px.
const LABEL: f64 = 11.0;
/// Space for the descenders of that label, and on both sides of the ticks of the y axis, px.
const GAP: f64 = 6.0;
/// Largest width of a digit, px.
const DIGIT: f64 = 7.0;

/// Title and axis labels of a panel.
pub(crate) struct Labels<'a> {
    pub title: &'a str,
    pub x: &'a str,
    pub y: &'a str,
}

/// Maps data to pixels on two axes.
pub(crate) struct Plot {
    x: Axis,
    y: Axis,
    left: f64,
}

/// Maps data to pixels on one axis.
struct Axis {
    from: [f64; 2],
    to: [f64; 2],
    is_log: bool,
    ticks: Vec<f64>,
}

impl Axis {
    /// An axis from `low` to `high` with ticks at round values.
    fn new(low: f64, high: f64, to: [f64; 2], is_log: bool) -> Self {
        let ticks = if is_log { log_ticks(low, high) } else { linear_ticks(low, high) };
        Self { from: if is_log { [low.log10(), high.log10()] } else { [low, high] }, to, is_log, ticks }
    }

    fn pixel(&self, value: f64) -> f64 {
        let value = if self.is_log { value.log10() } else { value };
        let share = (value - self.from[0]) / (self.from[1] - self.from[0]);
        self.to[0] + share.clamp(-0.02, 1.02) * (self.to[1] - self.to[0])
    }
}

impl Plot {
    /// A plot that contains all of `points`, with a margin in y. A logarithmic x axis ignores points with x ≤ 0.
    pub(crate) fn new(points: &[[f64; 2]], log_x: bool) -> Self {
        let drawn: Vec<&[f64; 2]> = points.iter().filter(|[x, _]| !log_x || *x > 0.0).collect();
        let lowest = |axis: usize| drawn.iter().map(|point| point[axis]).fold(f64::INFINITY, f64::min);
        let highest = |axis: usize| drawn.iter().map(|point| point[axis]).fold(f64::NEG_INFINITY, f64::max);
        let range = |low: f64, high: f64| if high > low { (low, high) } else { (low - 0.5, low + 0.5) };
        let x_high = highest(0).max(f64::MIN_POSITIVE);
        let (x_low, x_high) = if log_x { (lowest(0).min(x_high / 2.0) / 1.1, x_high * 1.1) } else { (0.0, x_high) };
        let (y_low, y_high) = range(lowest(1), highest(1));
        let margin = 0.06 * (y_high - y_low);
        let y = Axis::new(y_low - margin, y_high + margin, [BOTTOM, TOP], false);
        let widest = y.ticks.iter().map(|tick| tick_text(*tick, &y).chars().count()).max().unwrap_or(0);
        let left = LABEL + 2.0 * GAP + DIGIT * widest as f64;
        Self { x: Axis::new(x_low, x_high, [left, RIGHT], log_x), y, left }
    }

    /// Whether a point with this x can be drawn.
    pub(crate) fn holds(&self, x: f64) -> bool {
        !self.x.is_log || x > 0.0
    }

    /// Position of a point in pixels.
    pub(crate) fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        [self.x.pixel(x), self.y.pixel(y)]
    }

    /// Position of a point as the coordinates of an SVG path.
    pub(crate) fn at(&self, point: [f64; 2]) -> String {
        let [x, y] = self.place(point);
        format!("{} {}", number(x, 1), number(y, 1))
    }

    /// A level line from a point to the right edge, as an SVG path.
    pub(crate) fn to_the_end(&self, point: [f64; 2]) -> String {
        format!("M{}H{RIGHT}", self.at(point))
    }

    /// Draws title, grid, ticks and axis labels.
    pub(crate) fn frame(&self, labels: &Labels<'_>) -> Markup {
        let left = self.left;
        let (middle_x, middle_y) = ((left + RIGHT) / 2.0, (TOP + BOTTOM) / 2.0);
        html! {
            text x="4" y="16" class="title" { (labels.title) }
            @for &tick in &self.y.ticks {
                @let at = self.y.pixel(tick);
                path class="grid" d=(format!("M{left} {}H{RIGHT}", number(at, 1))) {}
                (text([left - GAP, at + 4.0], "end", &tick_text(tick, &self.y)))
            }
            @for &tick in &self.x.ticks {
                @let at = self.x.pixel(tick);
                path class="grid" d=(format!("M{} {TOP}V{BOTTOM}", number(at, 1))) {}
                (text([at, BOTTOM + 15.0], "middle", &tick_text(tick, &self.x)))
            }
            path class="axis" d=(format!("M{left} {TOP}V{BOTTOM}H{RIGHT}")) {}
            (text([middle_x, BOTTOM + 33.0], "middle", labels.x))
            text transform=(format!("translate({LABEL} {middle_y}) rotate(-90)")) text-anchor="middle" { (labels.y) }
        }
    }

    /// Draws the numbers of lines at the right edge, each at the height of its line; overlapping numbers are pushed
    /// apart.
    pub(crate) fn end_numbers(&self, ends: impl Iterator<Item = (usize, f64)>) -> Markup {
        let mut numbers: Vec<(f64, usize)> = ends.map(|(style, y)| (self.y.pixel(y), style)).collect();
        numbers.sort_by(|a, b| a.0.total_cmp(&b.0));
        for i in 1..numbers.len() {
            numbers[i].0 = numbers[i].0.max(numbers[i - 1].0 + LABEL_STEP);
        }
        // If numbers were pushed below the plot, all numbers move up.
        let overshoot = numbers.last().map_or(0.0, |last| (last.0 - BOTTOM).max(0.0));
        html! {
            @for (at, style) in numbers {
                (text([RIGHT + 5.0, at - overshoot + 4.0], "start", &(style + 1).to_string()))
            }
        }
    }
}

/// Four to eight ticks at multiples of 1, 2 or 5 times a power of ten.
pub(crate) fn linear_ticks(low: f64, high: f64) -> Vec<f64> {
    let magnitude = 10.0_f64.powf(((high - low) / 5.0).log10().floor());
    let steps = [1.0, 2.0, 5.0, 10.0].map(|factor| factor * magnitude);
    let step = steps.into_iter().find(|step| (high - low) / step <= 7.0).unwrap_or(steps[3]);
    let (first, last) = ((low / step).ceil() as i64, (high / step).floor() as i64);
    (first..=last).map(|i| i as f64 * step).collect()
}

/// Ticks at round multiples of powers of ten: the coarsest set with at least three ticks.
fn log_ticks(low: f64, high: f64) -> Vec<f64> {
    const FACTORS: [&[f64]; 4] = [
        &[1.0],
        &[1.0, 2.0, 5.0],
        &[1.0, 1.5, 2.0, 3.0, 5.0, 7.0],
        &[1.0, 1.2, 1.5, 2.0, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0],
    ];
    let ticks = |factors: &[f64]| -> Vec<f64> {
        let powers = low.log10().floor() as i32..=high.log10().ceil() as i32;
        let all = powers.flat_map(|power| factors.iter().map(move |factor| factor * 10.0_f64.powi(power)));
        all.filter(|tick| (low..=high).contains(tick)).collect()
    };
    let choices = FACTORS.map(ticks);
    choices.iter().find(|ticks| ticks.len() >= 3).unwrap_or(&choices[3]).clone()
}

/// A tick's label.
fn tick_text(tick: f64, axis: &Axis) -> String {
    number(tick, tick_decimals(&axis.ticks))
}

/// The number of decimals that distinguishes neighbouring ticks.
pub(crate) fn tick_decimals(ticks: &[f64]) -> usize {
    let step = ticks.windows(2).map(|pair| pair[1] - pair[0]).fold(f64::INFINITY, f64::min);
    if step.is_finite() { (-step.log10().floor()).clamp(0.0, 6.0) as usize } else { 0 }
}
