//! Benchmarks of the engine's overhead: hashing, and a run in which every job is cached.

#[path = "../src/test_stages.rs"]
#[allow(dead_code)]
mod test_stages;

use std::path::Path;
use std::time::Duration;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use engine::digest::SourceDigests;
use engine::job::StopRequests;
use engine::scheduler::{self, RunOptions};
use engine::store::{ActionRecord, Provenance};
use engine::{ActionKey, CodeTable, CrateCode, Digest, KeyComponents, Plan, Registry, Store};
use serde_json::json;
use test_stages::{List, Work, Write};

const CODE: CodeTable =
    CodeTable { crates: &[crate_code("test-list"), crate_code("test-work"), crate_code("test-write")] };

const fn crate_code(name: &'static str) -> CrateCode {
    CrateCode { name, files: &[("src/lib.rs", "0")], dependencies: &[], reads_artifacts_of: &[], external: "0" }
}

/// Hashes 64 MiB in memory, and a folder of 256 files of 256 KiB with and without the cache of digests.
fn hashing(criterion: &mut Criterion) {
    let bytes = vec![7; 64 << 20];
    let mut group = criterion.benchmark_group("hashing");
    group.throughput(Throughput::Bytes(bytes.len() as u64)).sample_size(10);
    group.bench_function("sha256 in memory", |bench| bench.iter(|| Digest::of(&bytes)));

    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("capture");
    std::fs::create_dir(&folder).unwrap();
    for (number, piece) in bytes.chunks(256 << 10).enumerate() {
        std::fs::write(folder.join(format!("{number:03}.png")), piece).unwrap();
    }
    let cache = root.path().join("cache");
    let digest = |rehash| SourceDigests::load(&cache, rehash).digest(&folder).unwrap();
    group.bench_function("folder, hashed", |bench| bench.iter(|| digest(true)));
    // The cache does not trust files that changed less than 2 s before they were hashed.
    std::thread::sleep(Duration::from_millis(2500));
    let digests = SourceDigests::load(&cache, true);
    digests.digest(&folder).unwrap();
    std::fs::write(&cache, digests.changed_cache().unwrap().unwrap()).unwrap();
    group.bench_function("folder, cached digests", |bench| bench.iter(|| digest(false)));
    group.finish();
}

/// Resolves and runs a plan of 1,002 jobs whose results (20 files each) are all in the store.
fn cached_run(criterion: &mut Criterion) {
    let root = tempfile::tempdir().unwrap();
    let seeds: Vec<String> = (0..1000).map(|seed| seed.to_string()).collect();
    let recipe = format!(
        "[axes]\nseed = [{}]\n[nodes.text]\nstage = \"test-write\"\n[nodes.work]\nstage = \"test-work\"\n\
         over = [\"seed\"]\ninputs = {{ text = \"text\" }}\nparams = {{ steps = \"{{seed}}\" }}\n\
         [nodes.list]\nstage = \"test-list\"\ninputs = {{ texts = \"work\" }}\n",
        seeds.join(", ")
    )
    .replace("seed = [0, ", "seed = [1000, ");
    let path = root.path().join("recipe.toml");
    std::fs::write(&path, recipe).unwrap();
    let registry = Registry::new(CODE).with::<Write>().with::<Work>().with::<List>();
    let resolve =
        || engine::recipe::resolve(&path, &[], &registry, root.path()).unwrap_or_else(|errors| panic!("{errors}"));
    let plan = resolve();
    let store = Store::open(&root.path().join("store")).unwrap();
    fill(&plan, &store, root.path());
    let options = options(&plan, root.path());
    let rerun = |plan: &Plan| {
        let summary = scheduler::run(plan, &store, &options, &mut |_| ()).unwrap();
        assert_eq!((summary.counts.cached, summary.counts.total), (1002, 1002));
    };
    let mut group = criterion.benchmark_group("1,002 cached jobs");
    group.sample_size(10);
    group.bench_function("resolve the recipe", |bench| bench.iter(resolve));
    group.bench_function("run again", |bench| bench.iter(|| rerun(&plan)));
    group.finish();
}

/// Records a result for every node without running its job.
fn fill(plan: &Plan, store: &Store, root: &Path) {
    let sources = scheduler::Sources::default();
    let mut outcomes = vec![None; plan.nodes.len()];
    for index in 0..plan.nodes.len() {
        let scheduler::Readiness::Ready(components) = scheduler::readiness(plan, index, &outcomes, &sources) else {
            panic!("{} is not ready", plan.nodes[index].name);
        };
        let components: KeyComponents = *components;
        let output = root.join("output");
        std::fs::create_dir(&output).unwrap();
        for file in 0..20 {
            std::fs::write(output.join(format!("{file:02}.txt")), format!("{} {file}", index % 50)).unwrap();
        }
        let publication = store.publish(&output, &json!({})).unwrap();
        std::fs::remove_dir(&output).unwrap();
        let key = ActionKey::new(&components);
        store.put_record(&ActionRecord::new(components, Provenance::default(), &publication)).unwrap();
        let (content, measurements) = (publication.content, publication.measurements);
        outcomes[index] = Some(scheduler::NodeOutcome::Done(scheduler::Done { key, content, measurements }));
    }
}

fn options(plan: &Plan, root: &Path) -> RunOptions {
    RunOptions {
        data_root: root.to_owned(),
        targets: (0..plan.nodes.len()).collect(),
        force: Default::default(),
        found: Default::default(),
        jobs: 1,
        threads: 1,
        device: "cpu".into(),
        profile: false,
        pause_at: Default::default(),
        max_failures: None,
        timeout: None,
        rehash: false,
        log_filter: "info".into(),
        command: vec!["false".into()],
        stop: StopRequests::default(),
        heartbeat: Duration::from_secs(30),
        lease: engine::scheduler::LEASE,
        share: None,
    }
}

criterion_group!(benches, hashing, cached_run);
criterion_main!(benches);
