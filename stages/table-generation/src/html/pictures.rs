//! Typesets renders next to the ground truth, with colour-coded errors.

use maud::{Markup, html};

use crate::format::number;
use crate::pictures::{Comparison, ERROR_SCALE, FULL_ERROR, Picture, Sheet};
use crate::svg::{SAMPLE, scale_sample};

/// A picture of a sheet that a click enlarges: the figure is the target of its own link, so that no script is needed and
/// no image is embedded twice. Links in the enlarged figure lead to its neighbours, so that renders and ground truth can be
/// flipped through in place.
struct Zoom {
    /// Number of the sheet.
    sheet: usize,
    /// Position in the sheet; 0 is the ground truth.
    at: usize,
    /// Number of figures of the sheet.
    count: usize,
}

impl Zoom {
    fn id(&self) -> String {
        self.id_at(self.at)
    }

    fn id_at(&self, at: usize) -> String {
        format!("view-{}-{at}", self.sheet)
    }

    /// Links to the neighbours, and back to `home`.
    fn links(&self, home: &str) -> Markup {
        html! {
            nav class="zoom" {
                a href={ "#" (self.id_at((self.at + self.count - 1) % self.count)) } { "‹ previous" }
                a href={ "#" (home) } { "close" }
                a href={ "#" (self.id_at((self.at + 1) % self.count)) } { "next ›" }
            }
        }
    }
}

/// The key of the error maps, and one block per view; `section` is the id of the section.
pub(crate) fn sheets(sheets: &[Sheet], section: &str) -> Markup {
    let levels = number(255.0 * FULL_ERROR, 0);
    html! {
        p class="key" {
            "A click enlarges an image. Error map: "
            svg width=(SAMPLE[0]) height=(SAMPLE[1]) aria-hidden="true" { (scale_sample(ERROR_SCALE)) }
            " mean absolute difference over the channels, from 0 (dark) to " (levels) " or more of 255 levels (light)."
        }
        @for (at, content) in sheets.iter().enumerate() { (sheet(content, at, section)) }
    }
}

fn sheet(sheet: &Sheet, number: usize, section: &str) -> Markup {
    let what = format!("{}, view {}", sheet.scene, sheet.view);
    let home = format!("{section}-{number}");
    let zoom = |at: usize| Zoom { sheet: number, at, count: 1 + sheet.comparisons.len() };
    html! {
        h4 id=(home) { (what) " (" (sheet.why) ")" }
        div class="sheet" {
            figure id=(zoom(0).id()) {
                a class="pair" href={ "#" (zoom(0).id()) } { (image(&sheet.truth, &format!("ground truth of {what}"))) }
                figcaption { "ground truth" span class="of" { ", " (what) } }
                (zoom(0).links(&home))
            }
            @for (at, content) in sheet.comparisons.iter().enumerate() { (comparison(content, &what, &zoom(at + 1), &home)) }
        }
    }
}

fn comparison(content: &Comparison, what: &str, zoom: &Zoom, home: &str) -> Markup {
    let Comparison { row, psnr, render, error, .. } = content;
    html! {
        figure id=(zoom.id()) {
            a class="pair" href={ "#" (zoom.id()) } {
                (image(render, &format!("{row}: render of {what}")))
                (image(error, &format!("{row}: error map of {what}")))
            }
            figcaption { (row) ", " (number(*psnr, 2)) " dB" (outcome(content)) span class="of" { ", " (what) } }
            (zoom.links(home))
        }
    }
}

/// A note if the run is degenerate.
fn outcome(content: &Comparison) -> Markup {
    html! { @if content.is_degenerate { ", " strong { "degenerate" } } }
}

fn image(picture: &Picture, alternative: &str) -> Markup {
    let Picture { width, height, .. } = picture;
    // The ratio limits the enlarged image to the height of the screen.
    let ratio = f64::from(*width) / f64::from((*height).max(1));
    html! {
        img src=(picture.data_uri()) width=(width) height=(height) alt=(alternative) style={ "--ratio:" (number(ratio, 4)) };
    }
}
