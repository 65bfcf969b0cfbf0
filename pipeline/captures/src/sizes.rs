//! The sizes of a capture as static facts, from which stages derive the work of their jobs.

use engine::Facts;
use scene::{Split, facts};

/// The splits with the facts that count their views.
const VIEWS: [(Split, &str); 3] =
    [(Split::Train, facts::TRAIN_VIEWS), (Split::Val, facts::VAL_VIEWS), (Split::Test, facts::TEST_VIEWS)];

/// Adds the image size in pixels and the numbers of training, validation and test views.
pub fn with_sizes(known: Facts, (width, height): (u32, u32), views: [usize; 3]) -> Facts {
    let known = known.with(facts::WIDTH, width).with(facts::HEIGHT, height);
    VIEWS.iter().zip(views).fold(known, |known, ((_, fact), count)| known.with(fact, count))
}

/// The number of pixels of a view, if it is known.
pub fn pixels_per_view(known: &Facts) -> Option<f64> {
    Some(known.count(facts::WIDTH)? as f64 * known.count(facts::HEIGHT)? as f64)
}

/// The number of views of a split, if it is known.
pub fn view_count(known: &Facts, split: Split) -> Option<f64> {
    let (_, fact) = VIEWS.iter().find(|(own, _)| *own == split)?;
    known.count(fact).map(|count| count as f64)
}

/// The number of views of all splits, if it is known.
pub fn all_views(known: &Facts) -> Option<f64> {
    VIEWS.iter().map(|(split, _)| view_count(known, *split)).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sizes_survive_as_facts() {
        let known = with_sizes(Facts::default(), (40, 30), [5, 2, 3]);
        assert_eq!((pixels_per_view(&known), all_views(&known)), (Some(1200.0), Some(10.0)));
        assert_eq!(view_count(&known, Split::Test), Some(3.0));
        assert_eq!((pixels_per_view(&Facts::default()), all_views(&Facts::default())), (None, None));
    }
}
