use std::io::ErrorKind;

use clap::{CommandFactory, Parser};
use engine::FailureKind;
use engine::event::{Counts, Event, NodeResult, Outcome};

use crate::args::{Cli, parse_times};
use crate::display::lines::Lines;
use crate::error::CliError;
use crate::output::{count, duration};
use crate::stages::stages;

#[test]
fn the_command_line_is_consistent() {
    Cli::command().debug_assert();
    assert!(Cli::try_parse_from(["pipeline", "run", "r.toml", "-s", "a=1", "--timeout", "2h", "--json"]).is_ok());
    assert!(Cli::try_parse_from(["pipeline", "run", "r.toml", "--timeout", "soon"]).is_err());
    assert!(Cli::try_parse_from(["pipeline", "run", "r.toml", "--fail-fast", "--max-failures", "2"]).is_err());
}

#[test]
fn options_that_make_no_sense_are_usage_errors() {
    for wrong in ["--jobs=0", "--threads=0", "--max-failures=0", "--jobs=-1", "--log=foo=bar=baz"] {
        assert!(Cli::try_parse_from(["pipeline", "run", "r.toml", wrong]).is_err(), "{wrong}");
    }
    for right in ["--jobs=1", "--log=debug", "--log=training=trace,info"] {
        assert!(Cli::try_parse_from(["pipeline", "run", "r.toml", right]).is_ok(), "{right}");
    }
}

#[test]
fn exit_codes_tell_the_users_errors_from_the_machines() {
    let code = |kind| CliError::of_input(engine::Failure::new(kind, "").into()).exit_code();
    let of_io = |kind: ErrorKind| CliError::of_input(std::io::Error::from(kind).into()).exit_code();
    let of_output = |kind: ErrorKind| CliError::Output(kind.into()).exit_code();
    assert_eq!([code(FailureKind::BadInput), code(FailureKind::MissingData), code(FailureKind::World)], [3, 3, 13]);
    assert_eq!([of_io(ErrorKind::NotFound), of_io(ErrorKind::StorageFull)], [3, 13]);
    assert_eq!(CliError::of_input(anyhow::anyhow!("time 2 s is outside")).exit_code(), 3);
    assert_eq!([of_output(ErrorKind::BrokenPipe), of_output(ErrorKind::StorageFull)], [141, 13]);
}

#[test]
fn every_stage_is_registered_under_its_crate() {
    // Building the registry checks that each id is a crate in the table of sources.
    assert!(stages().stages().count() >= 6);
}

#[test]
fn times_have_both_ends() {
    assert_eq!(parse_times("0:1:3").unwrap().0, [0.0, 0.5, 1.0]);
    assert_eq!(parse_times("2:9:1").unwrap().0, [2.0]);
    for wrong in ["", "0:1", "0:1:0", "0:1:-2", "0:nan:3", "0:1:2:3", "a:1:2", "0:1:99999999999999"] {
        assert!(parse_times(wrong).is_err(), "{wrong}");
    }
}

#[test]
fn numbers_read_well() {
    assert_eq!([0.43, 12.4, 200.0, 7500.0].map(duration), ["0.4 s", "12 s", "3 min 20 s", "2 h 5 min"]);
    assert_eq!([count(1, "job"), count(0, "job")], ["1 job", "0 jobs"]);
}

#[test]
fn logs_have_a_line_per_change_and_none_per_cached_job() {
    let mut lines = Lines::default();
    let mut line = |event: Event| lines.line(&event);
    line(Event::Planned { run: "r".into(), recipe: "dnerf".into(), jobs: 240 });
    let cached = NodeResult::new(Outcome::Cached);
    assert_eq!(line(Event::Finished { node: "capture/lego".into(), result: cached }), None);
    let executed = NodeResult { wall_secs: Some(12.0), ..NodeResult::new(Outcome::Executed) };
    let done = line(Event::Finished { node: "train/lego".into(), result: executed });
    assert_eq!(done.as_deref(), Some("[2/240] done train/lego in 12 s"));

    let counts = Counts { total: 240, cached: 11, executed: 1, running: 3, failed: 1, ..Counts::default() };
    let progress = engine::Progress { done: 9000, total: 30000, message: "27.4 dB".into() };
    let alive = line(Event::Heartbeat { counts, running: vec![("train/lego".into(), progress)] });
    assert_eq!(alive.as_deref(), Some("[12/240 done, 3 running, 1 failed] train/lego step 9000/30000 27.4 dB"));
}
