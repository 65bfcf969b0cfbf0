//! Gaps between the numbers in the names of a video's frames.

use scene::statistics::median;

use super::places::Places;
use crate::image_names::varying_number;

/// A step between successive numbers is a gap above this multiple of the median step: time stamps vary by less.
const LONG_STEP: f64 = 1.5;

/// A warning if images of one camera have names that differ in one number, whose steps are unequal: blurred frames may have been
/// deleted before structure from motion.
pub(super) fn warning(places: &Places<'_>) -> Option<String> {
    let names: Vec<&str> = places.of.keys().copied().collect();
    let first_camera = places.of.values().next()?.0;
    if places.of.values().any(|(camera, _)| *camera != first_camera) {
        return None;
    }
    let mut numbered: Vec<(f64, &str)> = varying_number(&names)?.into_iter().zip(names).collect();
    numbered.sort_by(|a, b| a.0.total_cmp(&b.0));
    let steps: Vec<f64> = numbered.windows(2).map(|pair| pair[1].0 - pair[0].0).collect();
    let usual = median(steps.iter().copied()).filter(|step| *step > 0.0)?;
    let (at, longest) = steps.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let gaps = steps.iter().filter(|step| **step > LONG_STEP * usual).count();
    let (before, after, length) = (numbered[at].1, numbered[at + 1].1, longest / usual);
    (gaps > 0).then(|| {
        format!(
            "the numbers in the names of images have gaps ({gaps}): {after} is {length:.1} usual steps after {before}, but times follow \
             the rank, so that it is the next frame; put the missing images back into their folder (without a pose, they only \
             leave a gap in time), or import the images before and after a long gap as two captures"
        )
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::colmap::model::Model;
    use crate::colmap::places::places;

    fn of(names: &[&str]) -> Option<String> {
        warning(&places(names.iter().copied(), &Model::default()))
    }

    #[test]
    fn deleted_frames_are_noticed() {
        let found = of(&["f_1.png", "f_2.png", "f_3.png", "f_8.png", "f_9.png", "f_13.png"]).unwrap();
        let expected = "the numbers in the names of images have gaps (2): f_8.png is 5.0 usual steps after f_3.png";
        assert!(found.starts_with(expected), "{found}");
        let nanoseconds = ["1700000000000000000.jpg", "1700000000033333333.jpg", "1700000000066666666.jpg"];
        assert_eq!(of(&nanoseconds), None);
        let late = [nanoseconds.as_slice(), &["1700000001066666666.jpg"]].concat();
        assert!(of(&late).unwrap().contains("30.0 usual steps"), "{:?}", of(&late));
    }

    #[test]
    fn seconds_are_decimal_numbers() {
        let second = |frame: u32| format!("{}.png", (1e3 * f64::from(frame) / 30.0).round() / 1e3);
        let names: Vec<String> = (1..20).map(second).collect();
        let mut names: Vec<&str> = names.iter().map(String::as_str).collect();
        assert_eq!(names[1..3], ["0.067.png", "0.1.png"]);
        assert_eq!(of(&names), None);
        names.drain(5..9);
        assert!(of(&names).unwrap().contains("0.333.png is 5.0 usual steps after 0.167.png"), "{:?}", of(&names));
    }

    #[test]
    fn equal_steps_and_other_names_have_no_gaps() {
        for names in [
            ["f_010.png", "f_020.png", "f_030.png", "f_040.png"],
            ["8.png", "9.png", "10.png", "11.png"],
            ["100.png", "133.png", "167.png", "210.png"],
            ["a1_1.png", "a1_2.png", "a2_3.png", "a2_90.png"],
            ["a.png", "b.png", "c.png", "z.png"],
            ["0/1.png", "0/90.png", "1/1.png", "1/90.png"],
        ] {
            assert_eq!(of(&names), None, "{names:?}");
        }
    }
}
