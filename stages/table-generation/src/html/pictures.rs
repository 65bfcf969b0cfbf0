//! Typesets renders beside the ground truth, with colour-coded errors.

use maud::{Markup, html};

use crate::format::number;
use crate::pictures::{Comparison, ERROR_SCALE, FULL_ERROR, Picture, Sheet};
use crate::svg::{SAMPLE, scale_sample};

/// The key of the error maps, and one block per view.
pub(crate) fn sheets(sheets: &[Sheet]) -> Markup {
    let levels = number(255.0 * FULL_ERROR, 0);
    html! {
        p class="key" {
            "Error map: " svg width=(SAMPLE[0]) height=(SAMPLE[1]) aria-hidden="true" { (scale_sample(ERROR_SCALE)) }
            " mean absolute difference over the channels, from 0 (dark) to " (levels) " or more of 255 levels (light)."
        }
        @for content in sheets { (sheet(content)) }
    }
}

fn sheet(sheet: &Sheet) -> Markup {
    let what = format!("{}, view {}", sheet.scene, sheet.view);
    html! {
        h4 { (what) " (" (sheet.why) ")" }
        div class="sheet" {
            figure { (image(&sheet.truth, &format!("ground truth of {what}"))) figcaption { "ground truth" } }
            @for content in &sheet.comparisons { (comparison(content, &what)) }
        }
    }
}

fn comparison(content: &Comparison, what: &str) -> Markup {
    let Comparison { row, psnr, render, error } = content;
    html! {
        figure {
            div class="pair" {
                (image(render, &format!("{row}: render of {what}")))
                (image(error, &format!("{row}: error map of {what}")))
            }
            figcaption { (row) ", " (number(*psnr, 2)) " dB" }
        }
    }
}

fn image(picture: &Picture, alternative: &str) -> Markup {
    html! { img src=(picture.data_uri()) width=(picture.width) height=(picture.height) alt=(alternative); }
}
