//! Submissions to a fake Slurm.

use super::*;
use crate::cells::tests::plan;
use crate::fakes::{has_fakes, shared};
use crate::{Process, RunFile};

/// Numbers jobs from 1, and refuses those from the number in the file `refuse_from`.
const SBATCH: &str = r#"cd "$CLUSTER_TEST_WITH_FAKES"
echo x >> jobs; id=$(wc -l < jobs); [ "$id" -ge "$(cat refuse_from)" ] && { echo 'QOS limit' >&2; exit 1; }
echo "$id""#;
/// Records what is cancelled; fails if the file `away` exists.
const SCANCEL: &str = r#"cd "$CLUSTER_TEST_WITH_FAKES"; [ -e away ] && exit 1
echo "$*" >> cancelled"#;
const FAKES: [(&str, &str); 2] = [("sbatch", SBATCH), ("scancel", SCANCEL)];

/// A run of two trainings that read one capture; each class of jobs is an array.
fn run<'a>(store: &'a Store, plan: &'a Plan) -> ClusterRun<'a> {
    let site = Site {
        cluster: ClusterFile::default(),
        program: "pipeline".into(),
        training: "train".into(),
        pilots: None,
        search: None,
        max_array: 10,
    };
    let run = ClusterRun { store, run: "r".into(), plan, site };
    run.create().unwrap();
    run
}

fn small_plan() -> Plan {
    let mut plan = plan("capture; train_a <- capture; train_b <- capture; report <- * train_a train_b");
    plan.nodes.iter_mut().filter(|node| node.name.starts_with("train")).for_each(|node| node.stage = "train".into());
    plan
}

fn refuse_from(job: usize) {
    fs::write(shared("refuse_from"), job.to_string()).unwrap();
}

fn cancelled() -> String {
    fs::read_to_string(shared("cancelled")).unwrap_or_default()
}

#[test]
fn a_refused_job_undoes_its_wave() {
    if !has_fakes("wave::tests::a_refused_job_undoes_its_wave", &FAKES, |_| ()) {
        return;
    }
    let (dir, plan) = (tempfile::tempdir().unwrap(), small_plan());
    let store = Store::open(dir.path()).unwrap();
    let (run, nodes) = (run(&store, &plan), (0..4).collect());
    refuse_from(3);
    let error = run.submit(1, &nodes).unwrap_err().to_string();
    assert!(error.contains("run r") && error.contains("(2 batch jobs cancelled)"), "{error}");
    assert!(error.contains("QOS limit") && error.contains("`pipeline attach r`"), "{error}");
    assert_eq!(cancelled(), "1 2\n");
    assert!(run.newest_wave().unwrap().is_none(), "the wave counts as not submitted");
    refuse_from(100);
    assert_eq!(run.submit(1, &nodes).unwrap().unwrap().all_jobs(), [4, 5, 6]);
    assert!(run.submit(1, &nodes).unwrap().is_none(), "another process was faster");
}

#[test]
fn a_follower_submits_after_missing_and_damaged_waves() {
    if !has_fakes("wave::tests::a_follower_submits_after_missing_and_damaged_waves", &FAKES, |_| ()) {
        return;
    }
    let (dir, plan) = (tempfile::tempdir().unwrap(), small_plan());
    let store = Store::open(dir.path()).unwrap();
    let run = run(&store, &plan);
    refuse_from(100);
    let file = RunFile {
        recipe: "r.toml".into(),
        data_root: dir.path().into(),
        targets: (0..4).collect(),
        force: BTreeSet::new(),
        device: "cpu".into(),
        profile: false,
        max_failures: None,
        timeout: None,
        log_filter: "info".into(),
        lease: Duration::from_secs(60),
    };
    let process =
        Process { jobs: 1, threads: 1, device: "cpu".into(), command: vec!["false".into()], stop: Default::default() };
    let close = || {
        let newest = run.newest_wave().unwrap().map_or(0, |wave| wave.number);
        run.close(&file, &process, newest, &mut |_| ()).unwrap()
    };
    assert_eq!((close(), run.wave(1).unwrap().all_jobs()), (0, vec![1, 2, 3]));
    fs::write(run.folder().join("wave-1.json"), "{").unwrap();
    assert_eq!((close(), run.wave(2).unwrap().all_jobs()), (0, vec![4, 5, 6]));
}

#[test]
fn jobs_that_cannot_be_cancelled_stay_known() {
    if !has_fakes("wave::tests::jobs_that_cannot_be_cancelled_stay_known", &FAKES, |_| ()) {
        return;
    }
    let (dir, plan) = (tempfile::tempdir().unwrap(), small_plan());
    let store = Store::open(dir.path()).unwrap();
    let run = run(&store, &plan);
    refuse_from(2);
    fs::write(shared("away"), "").unwrap();
    let error = run.submit(1, &(0..4).collect()).unwrap_err().to_string();
    assert!(error.contains("1 batch job not cancelled") && error.contains("`pipeline cancel r`"), "{error}");
    fs::remove_file(shared("away")).unwrap();
    assert_eq!(run.cancel().unwrap(), 1);
    assert_eq!(cancelled(), "1\n");
}

#[test]
fn damaged_waves_do_not_prevent_cancelling() {
    if !has_fakes("wave::tests::damaged_waves_do_not_prevent_cancelling", &FAKES, |_| ()) {
        return;
    }
    let (dir, plan) = (tempfile::tempdir().unwrap(), small_plan());
    let store = Store::open(dir.path()).unwrap();
    let run = run(&store, &plan);
    refuse_from(100);
    run.submit(1, &(0..4).collect()).unwrap();
    let damaged = run.folder().join("wave-2.json");
    fs::write(&damaged, "").unwrap();
    let newest = run.newest_wave().unwrap().unwrap();
    assert_eq!((newest.number, newest.all_jobs()), (2, Vec::new()));
    assert_eq!(run.damaged_waves().unwrap(), [damaged]);
    assert_eq!(run.cancel().unwrap(), 3);
    assert_eq!(cancelled(), "1 2 3\n");
    assert!(run.has_ended());
}
