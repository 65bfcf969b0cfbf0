//! What a curve of quality over seconds says about deadlines.

use metric_evaluation::Score;

use crate::Column;
use crate::collect::CurvePoint;

/// A question to a curve.
enum Question {
    /// Seconds until the PSNR (in dB) first reached this share of its last value.
    SecondsToShare(f64),
    /// Seconds until the PSNR first reached this many dB.
    SecondsToDb(f64),
    /// The PSNR of the last evaluation within this many seconds.
    PsnrWithin(f64),
}

impl Column {
    fn question(self) -> Option<Question> {
        Some(match self {
            Self::SecsTo90 => Question::SecondsToShare(0.90),
            Self::SecsTo95 => Question::SecondsToShare(0.95),
            Self::SecsTo99 => Question::SecondsToShare(0.99),
            Self::SecsTo25Db => Question::SecondsToDb(25.0),
            Self::SecsTo30Db => Question::SecondsToDb(30.0),
            Self::SecsTo35Db => Question::SecondsToDb(35.0),
            Self::PsnrAt10s => Question::PsnrWithin(10.0),
            Self::PsnrAt60s => Question::PsnrWithin(60.0),
            Self::PsnrAt300s => Question::PsnrWithin(300.0),
            Self::PsnrAtEnd => Question::PsnrWithin(f64::INFINITY),
            _ => return None,
        })
    }

    /// What the figure is for a training with this curve; none for figures that no curve tells, and for a curve that
    /// was never evaluated.
    pub fn of_curve(self, curve: &[CurvePoint]) -> Option<Score> {
        let question = self.question()?;
        let evaluated = || curve.iter().filter_map(|point| Some((point.seconds, point.psnr_val?)));
        let (_, last) = evaluated().next_back()?;
        let reached = |wanted: f64| evaluated().find(|(_, psnr)| *psnr >= wanted).map(|(seconds, _)| seconds);
        let answer = match question {
            Question::SecondsToShare(share) => reached(share * last),
            Question::SecondsToDb(wanted) => reached(wanted),
            Question::PsnrWithin(budget) => {
                evaluated().take_while(|(secs, _)| *secs <= budget).last().map(|(_, db)| db)
            }
        };
        let silence = if matches!(question, Question::PsnrWithin(_)) { "not yet" } else { "never" };
        Some(answer.map_or_else(|| Score::undefined(silence), Score::Value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve() -> Vec<CurvePoint> {
        let point = |(seconds, psnr)| CurvePoint { seconds, iteration: 0, n_gaussians: 0, psnr_val: Some(psnr) };
        [(4.0, 20.0), (20.0, 27.0), (70.0, 31.0), (90.0, 30.0)].map(point).into()
    }

    #[test]
    fn a_deadline_gets_the_last_evaluation_before_it() {
        let value = |column: Column| column.of_curve(&curve()).and_then(|score| score.value());
        assert_eq!(Column::BUDGETS.map(value), [Some(20.0), Some(27.0), Some(30.0), Some(30.0)]);
        assert_eq!(Column::TIME_TO_DB.map(value), [Some(20.0), Some(70.0), None]);
        assert_eq!(Column::TIME_TO_SHARE.map(value), [Some(20.0), Some(70.0), Some(70.0)]);
    }

    #[test]
    fn what_was_never_reached_says_so() {
        assert_eq!(Column::SecsTo35Db.of_curve(&curve()), Some(Score::undefined("never")));
        assert_eq!(Column::PsnrAt10s.of_curve(&curve()[1..]), Some(Score::undefined("not yet")));
        assert_eq!(Column::PsnrAt10s.of_curve(&[]), None);
        assert_eq!(Column::Gaussians.of_curve(&curve()), None);
    }
}
