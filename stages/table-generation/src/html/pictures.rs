//! Renders beside the true image, with the error in colour.

use maud::{Markup, html};

use crate::format::number;
use crate::pictures::{Comparison, ERROR_SCALE, FULL_ERROR, Picture, Sheet};
use crate::svg::{SAMPLE, scale_sample};

/// One block per view.
pub fn sheets(sheets: &[Sheet]) -> Markup {
    let levels = number(255.0 * FULL_ERROR, 0);
    html! {
        p class="key" {
            "Error: " svg width=(SAMPLE[0]) height=(SAMPLE[1]) aria-hidden="true" { (scale_sample(ERROR_SCALE)) }
            " from no difference (dark) to " (levels) " of 255 levels or more (light), mean over the channels."
        }
        @for content in sheets { (sheet(content)) }
    }
}

fn sheet(sheet: &Sheet) -> Markup {
    let what = format!("{}, view {}", sheet.scene, sheet.view);
    html! {
        h4 { (what) " (" (sheet.why) ")" }
        div class="sheet" {
            figure { (image(&sheet.truth, &format!("true image of {what}"))) figcaption { "truth" } }
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
                (image(error, &format!("{row}: error on {what}")))
            }
            figcaption { (row) ", " (number(*psnr, 2)) " dB" }
        }
    }
}

fn image(picture: &Picture, alternative: &str) -> Markup {
    html! { img src=(picture.data_uri()) width=(picture.width) height=(picture.height) alt=(alternative); }
}
