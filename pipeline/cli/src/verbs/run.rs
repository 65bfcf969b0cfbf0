//! `run`: runs a recipe once or, with `--precision`, adds seeds until its differences are known precisely enough.

use std::path::Path;

use engine::exit;
use table_generation::RowDifference;

use super::once::once;
use super::search::{search, settings};
use crate::args::RunArgs;
use crate::error::CliError;
use crate::output::note;

/// Seeds of the first run: with fewer, an interval is not informative.
const FEWEST: usize = 3;
/// Maximum number of seeds.
const MOST: usize = 8;

pub(crate) fn run(store: &Path, args: &RunArgs) -> Result<u8, CliError> {
    if let Some(settings) = settings(args)? {
        return search(store, args, &settings);
    }
    match args.precision {
        Some(half_width_db) => until_precise(store, args, half_width_db),
        None => Ok(once(store, &args.recipe, args)?.code),
    }
}

/// Runs a recipe with one seed more at a time. The rule uses only the widths of the intervals, never whether they
/// contain 0: stopping on significance would bias the results. It also stops when the spread is small by
/// chance, so the 95 % of the intervals are nominal: at least 91 % in simulations.
fn until_precise(store: &Path, args: &RunArgs, half_width_db: f64) -> Result<u8, CliError> {
    let mut recipe = args.recipe.clone();
    for seeds in FEWEST..=MOST {
        recipe.with.replicates = Some(seeds);
        let ended = once(store, &recipe, args)?;
        let has_ended = ![exit::OK, exit::DEGENERATE].contains(&ended.code);
        let Some((widest, text)) = widest(&ended.differences) else {
            note("the report compares nothing, so no seeds are added");
            return Ok(ended.code);
        };
        let is_precise = widest <= half_width_db;
        let next = match (has_ended, is_precise, seeds < MOST) {
            (true, ..) => "the run did not finish, so no seeds are added",
            (_, true, _) => "precise enough",
            (_, _, true) => "adding a seed",
            _ => "no more seeds are added",
        };
        note(&format!("{seeds} seeds: {text}; {next}"));
        if has_ended || is_precise || seeds == MOST {
            note(&format!("see {}", recipe.command("table", store)));
            return Ok(ended.code);
        }
    }
    Ok(exit::OK)
}

/// Half the width of the widest interval, and its difference in words; a difference without an interval is the widest.
fn widest(differences: &[RowDifference]) -> Option<(f64, String)> {
    let width = |difference: &RowDifference| difference.psnr.half_width.unwrap_or(f64::INFINITY);
    let widest = differences.iter().max_by(|a, b| width(a).total_cmp(&width(b)))?;
    let RowDifference { row, reference, .. } = widest;
    let text = match widest.psnr.half_width {
        Some(half) => format!("the widest interval is ± {half:.2} dB ({row} − {reference})"),
        None => format!("{row} − {reference} has no interval, because seeds are missing"),
    };
    Some((width(widest), text))
}

#[cfg(test)]
mod tests {
    use table_generation::Difference;

    use super::*;

    fn difference(row: &str, half_width: Option<f64>) -> RowDifference {
        let psnr = Difference { mean: 1.0, half_width, seeds: 3 };
        RowDifference { protocol: "A".into(), row: row.into(), reference: "base".into(), psnr }
    }

    #[test]
    fn the_widest_interval_decides_and_a_missing_one_is_wider_than_all() {
        let known = [difference("a", Some(0.1)), difference("b", Some(0.4)), difference("c", Some(0.2))];
        assert_eq!(widest(&known).unwrap(), (0.4, "the widest interval is ± 0.40 dB (b − base)".into()));
        let unknown = [difference("a", Some(0.1)), difference("b", None)];
        assert_eq!(widest(&unknown).unwrap().0, f64::INFINITY);
        assert_eq!(widest(&[]), None);
    }
}
