use std::io::ErrorKind;

use clap::{CommandFactory, Parser};
use engine::FailureKind;
use engine::event::{Counts, Event, NodeResult, Outcome};

use crate::args::{Cli, Verb};
use crate::display::lines::Lines;
use crate::error::CliError;
use crate::output::{count, duration};
use crate::stages::stages;

/// The help of a verb and of the verbs below it, without the values of environment variables.
fn help_texts(command: clap::Command) -> String {
    let mut command = command.mut_args(|arg| arg.hide_env_values(true));
    let mut text = command.render_long_help().to_string();
    for verb in command.get_subcommands().filter(|verb| !verb.is_hide_set() && verb.get_name() != "help") {
        text += &format!("\n==== {}\n\n{}", verb.get_bin_name().unwrap_or_default(), help_texts(verb.clone()));
    }
    text
}

#[test]
fn help_texts_are_reviewed() {
    let mut command = Cli::command().term_width(100);
    command.build();
    insta::assert_snapshot!(help_texts(command));
}

#[test]
fn command_line_is_consistent() {
    Cli::command().debug_assert();
    assert!(Cli::try_parse_from(["pipeline", "run", "r.toml", "-s", "a=1", "--timeout", "2h", "--json"]).is_ok());
    assert!(Cli::try_parse_from(["pipeline", "run", "r.toml", "--timeout", "soon"]).is_err());
    assert!(Cli::try_parse_from(["pipeline", "plan", "r.toml", "--threads", "1"]).is_ok(), "as in `run`");
    assert!(Cli::try_parse_from(["pipeline", "run", "r.toml", "--fail-fast", "--max-failures", "2"]).is_err());
    for limit in ["--fail-fast", "--max-failures=2"] {
        let run = ["pipeline", "run", "r.toml", "--workers=2", limit];
        assert!(Cli::try_parse_from(run).is_ok());
        assert!(
            Cli::try_parse_from(run.into_iter().chain(["--on=slurm"])).is_err(),
            "batch jobs do not count together"
        );
    }
    let render =
        |options: &[&str]| Cli::try_parse_from([&["pipeline", "render", "r.toml", "a", "b"], options].concat());
    assert!(render(&["--views=test", "--truth", "--scale=2", "--fps=8", "--gif=a.gif"]).is_ok());
    assert!(render(&["--views=test", "--out=o"]).is_ok() && render(&["--views=test"]).is_err());
    assert!(render(&["--views=test", "--truth", "--scale=2", "--sheet=a.png"]).is_ok());
    for not_of_sheets in ["--gif=a.gif", "--out=o", "--fps=8"] {
        assert!(render(&["--views=test", "--sheet=a.png", not_of_sheets]).is_err(), "{not_of_sheets}");
    }
    for gif_only in ["--truth", "--scale=2", "--fps=8", "--gif=a.gif"] {
        assert!(render(&["--views=test", "--out=o", gif_only]).is_err(), "{gif_only}");
    }
    let missing = |options: &[&str], named: [&str; 2]| {
        let error = render(options).expect_err("an option is missing").to_string();
        assert!(named.iter().all(|option| error.contains(option)), "{error}");
    };
    missing(&["--out=o"], ["--times <FIRST:LAST:COUNT>", "--views <VIEW,…>"]);
    missing(&["--views=test"], ["--gif <FILE>", "--sheet <FILE>"]);
    let Verb::Render(spaced) = render(&["--times=0:1:3", "--views= train_1, test", "--sheet=A.PNG"]).unwrap().verb
    else {
        panic!("another verb");
    };
    assert_eq!(spaced.views, ["train_1", "test"]);
}

#[test]
fn senseless_options_are_usage_errors() {
    let mut messages = String::new();
    for wrong in [
        &["run", "r.toml", "--jobs=0"][..],
        &["run", "r.toml", "--threads=0"],
        &["run", "r.toml", "--max-failures=0"],
        &["run", "r.toml", "--jobs=-1"],
        &["run", "r.toml", "--timeout=0s"],
        &["run", "r.toml", "--lease=0s"],
        &["run", "r.toml", "--within=0s"],
        &["run", "r.toml", "--sweep=a=1,2,1.0"],
        &["run", "r.toml", "--log=foo=bar=baz"],
        &["plan", "r.toml", "--device="],
        &["plan", "r.toml", "--budget=0s"],
        &["plan", "r.toml", "--replicates=100000"],
        &["render", "r.toml", "train/a", "--out=o", "--times=0:1"],
        &["render", "r.toml", "train/a", "--out=o", "--times=0:1:99999999"],
        &["render", "r.toml", "train/a", "--views=test", "--gif=o1.png"],
        &["render", "r.toml", "train/a", "--views=test", "--sheet=o.jpg"],
        &["compare", "a.toml", "b.toml", "--rows=a"],
        &["compare", "a.toml", "b.toml", "--metric=psnrr"],
        &["compare", "a.toml", "b.toml", "--fail-if-worse=0.1"],
        &["compare", "a.toml", "b.toml", "--fail-if-worse=psnr=-1"],
        &["no-such-verb"],
    ] {
        let error = Cli::try_parse_from([&["pipeline"], wrong].concat()).expect_err("a usage error");
        let message = error.to_string();
        messages += &format!("{}\n  {}\n", wrong.join(" "), message.lines().next().unwrap_or_default());
    }
    insta::assert_snapshot!(messages);
    for right in ["--jobs=1", "--log=debug", "--log=training=trace,info"] {
        assert!(Cli::try_parse_from(["pipeline", "run", "r.toml", right]).is_ok(), "{right}");
    }
}

#[test]
fn hints_repeat_the_options_of_the_command_line() {
    let run = ["pipeline", "--store", "my store", "run", "r.toml", "-s", "name=\"a\"", "--replicates=2"];
    let run = [&run[..], &["--data-root=d", "--device=10de:2335", "--budget=1h30m"]].concat();
    let Cli { store, verb: Verb::Run(args) } = Cli::try_parse_from(run).expect("the options are right") else {
        panic!("another verb");
    };
    let expected = "pipeline table r.toml -s 'name=\"a\"' --replicates 2 --budget 1h30m --store 'my store' \
                    --data-root d --device 10de:2335";
    assert_eq!(args.recipe.command("table", &store), expected);
    let plain = Cli::try_parse_from(["pipeline", "run", "r.toml"]).expect("a plain run");
    let Verb::Run(args) = plain.verb else { panic!("another verb") };
    assert_eq!(args.recipe.command("table", &plain.store), "pipeline table r.toml", "whatever the variables are");
}

#[test]
fn exit_codes_separate_bad_input_from_machine_failures() {
    let code = |kind| CliError::of_input(engine::Failure::new(kind, "").into()).exit_code();
    let of_io = |kind: ErrorKind| CliError::of_input(std::io::Error::from(kind).into()).exit_code();
    let of_output = |kind: ErrorKind| CliError::Output(kind.into()).exit_code();
    assert_eq!([code(FailureKind::BadInput), code(FailureKind::MissingData), code(FailureKind::World)], [3, 3, 13]);
    assert_eq!([of_io(ErrorKind::NotFound), of_io(ErrorKind::StorageFull)], [3, 13]);
    assert_eq!(CliError::of_input(anyhow::anyhow!("time 2 s is outside")).exit_code(), 3);
    assert_eq!([of_output(ErrorKind::BrokenPipe), of_output(ErrorKind::StorageFull)], [141, 13]);
}

#[test]
fn errors_print_message_path_and_hint() {
    let failure = engine::Failure::new(FailureKind::BadInput, "no such folder").hint("name a folder").at("a/b");
    let frozen = |count: usize| CliError::Frozen((0..count).map(|index| format!("train/{index}")).collect());
    let errors = [
        CliError::nothing("no job matches `x`", "`pipeline plan RECIPE` lists all jobs"),
        frozen(2),
        frozen(9),
        CliError::Usage("--trials belongs to a search".into()),
        CliError::Damaged("the result of train/a is damaged: model.safetensors is corrupt".into()),
        CliError::Input(failure.into()),
        CliError::Other(anyhow::anyhow!("inner").context("outer")),
        CliError::Output(ErrorKind::StorageFull.into()),
    ];
    insta::assert_snapshot!(errors.map(|error| format!("{error}\n")).join("\n"), @r"
    error: no job matches `x`
    hint: `pipeline plan RECIPE` lists all jobs

    error: 2 jobs would have to run: train/0, train/1
    hint: run without --frozen; `pipeline plan` shows the reasons

    error: 9 jobs would have to run: train/0, train/1, train/2, train/3, train/4, …
    hint: run without --frozen; `pipeline plan` shows the reasons

    error: --trials belongs to a search

    error: the result of train/a is damaged: model.safetensors is corrupt
    hint: run the recipe again, which replaces damaged results; `pipeline cache verify` lists all damaged files

    error: no such folder: a/b
    hint: name a folder

    error: outer: inner

    error: cannot write to standard output (no storage space)
    ");
}

#[test]
fn every_stage_is_registered_under_its_crate() {
    let registry = stages();
    let mut registered: Vec<&str> = registry.stages().map(|stage| stage.id()).collect();
    registered.sort_unstable();
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../stages");
    let entries = std::fs::read_dir(folder).expect("stages/ exists").map(|entry| entry.expect("readable").file_name());
    let mut crates: Vec<String> = entries.map(|name| name.into_string().expect("UTF-8")).collect();
    crates.sort_unstable();
    assert_eq!(registered, crates);
}

#[test]
fn numbers_are_formatted_for_people() {
    assert_eq!([0.43, 12.4, 200.0, 7500.0].map(duration), ["0.4 s", "12 s", "3 min 20 s", "2 h 5 min"]);
    assert_eq!([count(1, "job"), count(0, "job")], ["1 job", "0 jobs"]);
}

#[test]
fn the_ending_lists_each_failure_once() {
    let failed = |message: &str| NodeResult {
        failure: Some(engine::Failure::new(FailureKind::Diverged, message).hint("lower the rate")),
        log_dir: Some("store/runs/r/jobs/x".into()),
        ..NodeResult::new(Outcome::Failed)
    };
    let missing = |path: &str| NodeResult {
        failure: Some(engine::Failure::new(FailureKind::MissingData, "the data is missing").at(path)),
        ..NodeResult::new(Outcome::MissingData)
    };
    let skipped = || NodeResult { because_of: Some("train/a".into()), ..NodeResult::new(Outcome::Skipped) };
    let train = ["train/a", "train/b", "train/c", "train/d"].map(|name| (name, failed("loss is NaN")));
    let others = [
        ("train/e", failed("no Gaussians left")),
        ("capture/x", missing("data/x")),
        ("capture/y", missing("data/y")),
        ("render/a", skipped()),
        ("render/b", skipped()),
    ];
    let results = train.into_iter().chain(others).map(|(name, result)| (name.to_owned(), result)).collect();
    let summary = engine::scheduler::RunSummary {
        run: "r".into(),
        recipe: "dnerf".into(),
        counts: Counts::default(),
        wall_secs: 1.0,
        stopped_by: None,
        sinks: Vec::new(),
        not_kept: None,
        results,
    };
    insta::assert_snapshot!(crate::display::summary::failures(&summary).join("\n"), @r"
    FAILED train/a, train/b, train/c and 1 more: loss is NaN; lower the rate
      log: store/runs/r/jobs/x/log
    FAILED train/e: no Gaussians left; lower the rate
      log: store/runs/r/jobs/x/log
    MISSING DATA capture/x, capture/y: the data is missing: data/x
    skipped 2 jobs that need these results
    ");
    let mut lines = Lines::default();
    let mut line = |result| lines.line(&Event::Finished { node: "train/a".into(), result });
    assert_eq!(line(failed("loss is NaN")).as_deref(), Some("[1/0] FAILED train/a (diverged)"));
    assert_eq!((line(skipped()), line(missing("x"))), (None, None));
}

#[test]
fn logs_have_a_line_per_change_and_none_per_cached_job() {
    let mut lines = Lines::default();
    let mut line = |event: Event| lines.line(&event);
    let (changes, device) = (Vec::new(), engine::DeviceClass::Cpu);
    line(Event::Planned { run: "r".into(), recipe: "dnerf".into(), changes, device, jobs: 240 });
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
