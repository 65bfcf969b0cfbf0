//! A temporary folder with a recipe, data and a store, and functions that run the recipe.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;

use engine::event::{Event, Outcome};
use engine::job::StopRequests;
use engine::scheduler::{self, RunOptions, RunSummary, Share};
use engine::{CodeTable, CrateCode, Digest, Plan, Registry, Store};
use tempfile::TempDir;

use crate::test_stages::{Join, List, Work, Write};

/// A recipe with two texts, two jobs on each, and a list of the four results.
pub(crate) const GRID: &str = r#"
name = "grid"
[axes]
scene = ["ball", "lego"]
seed = ["p", "q"]
[nodes.text]
stage = "test-write"
over = ["scene"]
params = { text = "{scene}:" }
[nodes.work]
stage = "test-work"
over = ["scene", "seed"]
inputs = { text = "text" }
params = { letter = "{seed}", steps = 3, sleep_millis = 10 }
[nodes.list]
stage = "test-list"
inputs = { texts = "work" }
"#;

const CODE: CodeTable = CodeTable {
    crates: &[crate_code("test-join"), crate_code("test-list"), crate_code("test-work"), crate_code("test-write")],
};

const fn crate_code(name: &'static str) -> CrateCode {
    CrateCode { name, files: &[("src/lib.rs", "0")], dependencies: &[], reads_artifacts_of: &[], external: "0" }
}

pub(crate) fn registry() -> Registry {
    with_stages(CODE)
}

/// The registry of another build, in which the code of one stage differs.
pub(crate) fn rebuilt_registry() -> Registry {
    const REBUILT: CodeTable = CodeTable {
        crates: &[
            crate_code("test-join"),
            crate_code("test-list"),
            CrateCode { files: &[("src/lib.rs", "1")], ..crate_code("test-work") },
            crate_code("test-write"),
        ],
    };
    with_stages(REBUILT)
}

fn with_stages(code: CodeTable) -> Registry {
    Registry::new(code).with::<Write>().with::<Work>().with::<Join>().with::<List>()
}

pub(crate) struct World {
    _keep: Option<TempDir>,
    pub(crate) root: PathBuf,
}

impl World {
    pub(crate) fn new(recipe: &str) -> Self {
        let keep = tempfile::tempdir().unwrap();
        let world = Self { root: keep.path().to_owned(), _keep: Some(keep) };
        std::fs::create_dir(world.root.join("data")).unwrap();
        std::fs::write(world.root.join("recipe.toml"), recipe).unwrap();
        world
    }

    pub(crate) fn store(&self) -> Store {
        Store::open(&self.root.join("store")).unwrap()
    }

    pub(crate) fn plan(&self, overrides: &[&str]) -> Plan {
        let overrides: Vec<String> = overrides.iter().map(|text| (*text).to_owned()).collect();
        engine::recipe::resolve(&self.root.join("recipe.toml"), &overrides, &registry(), &self.root.join("data"))
            .unwrap_or_else(|errors| panic!("{errors}"))
    }

    pub(crate) fn options(&self, plan: &Plan) -> RunOptions {
        RunOptions {
            data_root: self.root.join("data"),
            targets: (0..plan.nodes.len()).collect(),
            force: Default::default(),
            found: Default::default(),
            jobs: 4,
            threads: 4,
            device: "cpu".into(),
            profile: false,
            pause_at: Default::default(),
            max_failures: None,
            timeout: None,
            rehash: false,
            log_filter: "info".into(),
            command: vec![std::env::current_exe().unwrap().into(), "exec-job".into()],
            stop: StopRequests::default(),
            heartbeat: Duration::from_secs(30),
            lease: scheduler::LEASE,
            share: None,
        }
    }

    pub(crate) fn run(&self, overrides: &[&str]) -> RunSummary {
        self.run_with(overrides, |_| (), |_, _| ())
    }

    /// Runs the recipe with adjusted options; `watch` receives every event.
    pub(crate) fn run_with(
        &self,
        overrides: &[&str],
        adjust: impl FnOnce(&mut RunOptions),
        mut watch: impl FnMut(&RunOptions, &Event),
    ) -> RunSummary {
        let plan = self.plan(overrides);
        let mut options = self.options(&plan);
        adjust(&mut options);
        scheduler::run(&plan, &self.store(), &options, &mut |event| watch(&options, event)).unwrap()
    }

    /// The text in a node's artifact.
    pub(crate) fn text(&self, summary: &RunSummary, node: &str) -> String {
        let content = summary.results[node].content.unwrap_or_else(|| panic!("{node}: {:?}", summary.results[node]));
        std::fs::read_to_string(self.store().view(&content).unwrap().join("text.txt")).unwrap()
    }
}

/// The names of the nodes with this outcome.
pub(crate) fn nodes(summary: &RunSummary, outcome: Outcome) -> Vec<&str> {
    let found = summary.results.iter().filter(|(_, result)| result.outcome == outcome);
    found.map(|(name, _)| name.as_str()).collect()
}

/// The digest of every node's artifact.
pub(crate) fn contents(summary: &RunSummary) -> BTreeMap<String, Option<Digest>> {
    summary.results.iter().map(|(name, result)| (name.clone(), result.content)).collect()
}

/// Runs the recipe of an existing world in this process, like the program does.
pub(crate) fn schedule(root: &Path) -> ExitCode {
    let world = World { root: root.to_owned(), _keep: None };
    let plan = world.plan(&[]);
    let mut options = world.options(&plan);
    options.stop = StopRequests::listen().unwrap();
    let summary = scheduler::run(&plan, &world.store(), &options, &mut |_| ()).unwrap();
    ExitCode::from(summary.exit_code(false))
}

/// The lease in shared runs: a frozen process loses its jobs after this time. Long compared with the syncs of a busy
/// disk.
pub(crate) const SHORT_LEASE: Duration = Duration::from_secs(2);

/// Takes part in the shared run `run` of an existing world, like a worker of the program does.
pub(crate) fn work(root: &Path, run: &str, part: &str) -> ExitCode {
    let world = World { root: root.to_owned(), _keep: None };
    let plan = world.plan(&[]);
    let begin = part.parse::<f64>().unwrap() / 10.0;
    let mut options = RunOptions { jobs: 1, lease: SHORT_LEASE, ..world.options(&plan) };
    options.share = Some(Share {
        run: run.into(),
        name: format!("worker-{part}"),
        begin,
        following: None,
        only: None,
        missing: None,
        idle: None,
    });
    options.stop = StopRequests::listen().unwrap();
    let summary = scheduler::run(&plan, &world.store(), &options, &mut |_| ()).unwrap();
    ExitCode::from(summary.exit_code(false))
}
