//! Values derived from a curve of quality over training time: seconds to a quality, quality within a time.

use metric_evaluation::Score;

use super::run::CurvePoint;
use crate::column::Column;

/// A value derived from a curve.
enum Derived {
    /// Seconds until the PSNR (in dB) first reached this share of its last value.
    SecondsToShare(f64),
    /// Seconds until the PSNR first reached this many dB.
    SecondsToDb(f64),
    /// The PSNR of the last evaluation within this many seconds.
    PsnrWithin(f64),
}

fn derived(column: Column) -> Option<Derived> {
    Some(match column {
        Column::SecsTo90 => Derived::SecondsToShare(0.90),
        Column::SecsTo95 => Derived::SecondsToShare(0.95),
        Column::SecsTo99 => Derived::SecondsToShare(0.99),
        Column::SecsTo25Db => Derived::SecondsToDb(25.0),
        Column::SecsTo30Db => Derived::SecondsToDb(30.0),
        Column::SecsTo35Db => Derived::SecondsToDb(35.0),
        Column::PsnrAt10s => Derived::PsnrWithin(10.0),
        Column::PsnrAt60s => Derived::PsnrWithin(60.0),
        Column::PsnrAt300s => Derived::PsnrWithin(300.0),
        Column::PsnrAtEnd => Derived::PsnrWithin(f64::INFINITY),
        _ => return None,
    })
}

/// The column's value for a training with this curve; none for columns that no curve defines, and for a curve without
/// evaluations.
pub(crate) fn of_curve(column: Column, curve: &[CurvePoint]) -> Option<Score> {
    let derived = derived(column)?;
    let evaluated = || curve.iter().filter_map(|point| Some((point.seconds, point.psnr_val?)));
    let (_, last) = evaluated().next_back()?;
    let reached = |wanted: f64| evaluated().find(|(_, psnr)| *psnr >= wanted).map(|(seconds, _)| seconds);
    let value = match derived {
        Derived::SecondsToShare(share) => reached(share * last),
        Derived::SecondsToDb(wanted) => reached(wanted),
        Derived::PsnrWithin(budget) => evaluated().take_while(|(secs, _)| *secs <= budget).last().map(|(_, db)| db),
    };
    let undefined = if matches!(derived, Derived::PsnrWithin(_)) { "not yet" } else { "never" };
    Some(value.map_or_else(|| Score::undefined(undefined), Score::Value))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve() -> Vec<CurvePoint> {
        let point = |(seconds, psnr)| CurvePoint { seconds, iteration: 0, n_gaussians: 0, psnr_val: Some(psnr) };
        [(4.0, 20.0), (20.0, 27.0), (70.0, 31.0), (90.0, 30.0)].map(point).into()
    }

    #[test]
    fn deadlines_take_the_last_evaluation_before_them() {
        let value = |column: Column| of_curve(column, &curve()).and_then(|score| score.value());
        assert_eq!(Column::BUDGETS.map(value), [Some(20.0), Some(27.0), Some(30.0), Some(30.0)]);
        assert_eq!(Column::TIME_TO_DB.map(value), [Some(20.0), Some(70.0), None]);
        assert_eq!(Column::TIME_TO_SHARE.map(value), [Some(20.0), Some(70.0), Some(70.0)]);
    }

    #[test]
    fn unreached_qualities_are_undefined() {
        assert_eq!(of_curve(Column::SecsTo35Db, &curve()), Some(Score::undefined("never")));
        assert_eq!(of_curve(Column::PsnrAt10s, &curve()[1..]), Some(Score::undefined("not yet")));
        assert_eq!(of_curve(Column::PsnrAt10s, &[]), None);
        assert_eq!(of_curve(Column::Gaussians, &curve()), None);
    }
}
