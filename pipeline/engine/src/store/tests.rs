use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::os::unix::fs::symlink;
use std::path::Path;
use std::time::Duration;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde_json::json;

use super::{ActionRecord, Keep, Lookup, Provenance, Store};
use crate::event::{Event, NodeResult, Outcome};
use crate::{ActionKey, Failure, FailureKind, KeyComponents};

fn components(name: &str) -> KeyComponents {
    KeyComponents {
        stage: "test".into(),
        code: BTreeMap::new(),
        params: json!({ "name": name }),
        inputs: BTreeMap::new(),
        sources: BTreeMap::new(),
        output: ("text".into(), 1),
        environment: "cpu".into(),
    }
}

/// Publishes a folder of two files under the key of `name`.
fn publish(store: &Store, name: &str, text: &str) -> ActionRecord {
    let scratch = store.scratch("test").unwrap();
    let output = scratch.path().join("output");
    fs::create_dir_all(output.join("images")).unwrap();
    fs::write(output.join("text.txt"), text).unwrap();
    fs::write(output.join("images/0.png"), "shared by all").unwrap();
    let publication = store.publish(&output, &json!({ "seconds": 2 })).unwrap();
    let provenance = Provenance { node: name.into(), plan_id: format!("plan of {name}"), ..Provenance::default() };
    let record = ActionRecord::new(components(name), provenance, &publication);
    store.put_record(&record).unwrap();
    record
}

pub(super) fn key(name: &str) -> ActionKey {
    ActionKey::new(&components(name))
}

fn plan_of_b() -> Keep {
    Keep { plan_ids: BTreeSet::from(["plan of b".to_owned()]), ..Keep::default() }
}

fn is_hit(store: &Store, name: &str) -> bool {
    matches!(store.lookup(&key(name)), Lookup::Hit(_))
}

pub(super) fn with_store(test: impl FnOnce(&Store)) {
    let root = tempfile::tempdir().unwrap();
    test(&Store::open(&root.path().join("store")).unwrap());
}

#[test]
fn a_published_folder_is_read_in_place() {
    with_store(|store| {
        assert!(matches!(store.lookup(&key("a")), Lookup::Miss));
        let record = publish(store, "a", "hello");
        let Lookup::Hit(found) = store.lookup(&key("a")) else { panic!("not found") };
        assert_eq!(found.content, record.content);
        let view = store.view(&record.content).unwrap();
        assert_eq!(fs::read_to_string(view.join("text.txt")).unwrap(), "hello");
        assert_eq!(fs::read_to_string(view.join("images/0.png")).unwrap(), "shared by all");
        assert_eq!(store.read_measurements(&record.measurements).unwrap(), json!({ "seconds": 2 }));
        assert!(fs::read_link(view.join("images/0.png")).unwrap().is_relative());
        assert!(fs::metadata(view.join("text.txt")).unwrap().permissions().readonly());
    });
}

#[test]
fn an_artifact_with_a_page_is_copied_and_repaired() {
    with_store(|store| {
        let scratch = store.scratch("pages").unwrap();
        let output = scratch.path().join("output");
        fs::create_dir_all(&output).unwrap();
        fs::write(output.join("index.html"), "<!DOCTYPE html>").unwrap();
        fs::write(output.join("report.json"), "{}").unwrap();
        let content = store.publish(&output, &json!(null)).unwrap().content;
        let page = store.view(&content).unwrap().join("index.html");
        for file in ["index.html", "report.json"] {
            assert!(fs::symlink_metadata(page.with_file_name(file)).unwrap().is_file(), "{file}");
        }
        fs::remove_file(&page).unwrap();
        fs::write(&page, "<!DOCTYPE htm?>").unwrap();
        let again = store.view(&content).unwrap().join("index.html");
        assert_eq!(fs::read_to_string(again).unwrap(), "<!DOCTYPE html>");
    });
}

#[test]
fn store_files_respect_the_umask() {
    use std::os::unix::fs::PermissionsExt;
    with_store(|store| {
        let probe = store.root().parent().unwrap().join("probe");
        fs::write(&probe, "").unwrap();
        let may_read = fs::metadata(&probe).unwrap().permissions().mode() & 0o444;
        publish(store, "a", "hello");
        store.write_over(&store.stat_cache_file(), b"{}").unwrap();
        for file in super::maintenance::files_below(store.root()).unwrap() {
            let mode = fs::metadata(&file).unwrap().permissions().mode();
            assert_eq!(mode & may_read, may_read, "{mode:o} {}", file.display());
        }
    });
}

#[test]
fn a_damaged_view_is_rebuilt() {
    with_store(|store| {
        let content = publish(store, "a", "hello").content;
        let view = store.view(&content).unwrap();
        fs::remove_file(view.join("text.txt")).unwrap();
        assert_eq!(fs::read_to_string(store.view(&content).unwrap().join("text.txt")).unwrap(), "hello");
    });
}

#[test]
fn the_first_record_of_a_key_wins() {
    with_store(|store| {
        let first = publish(store, "a", "first");
        publish(store, "a", "second");
        let Lookup::Hit(found) = store.lookup(&key("a")) else { panic!("not found") };
        assert_eq!(found.content, first.content);
        store.retire_record(&key("a")).unwrap();
        let third = publish(store, "a", "third");
        let Lookup::Hit(found) = store.lookup(&key("a")) else { panic!("not found") };
        assert_eq!(found.content, third.content);
    });
}

#[test]
fn damaged_blobs_are_misses_until_published_again() {
    with_store(|store| {
        let record = publish(store, "a", "hello");
        let manifest = store.manifest(&record.content).unwrap();
        let blob = store.blob_path(&manifest.files[1].sha256);
        let damages: [&dyn Fn(); 5] = [
            &|| fs::remove_file(&blob).unwrap(),
            &|| replace(&blob, "HELLO"),
            &|| replace(&blob, "hell"),
            &|| replace(&store.blob_path(&record.content), "{}"),
            &|| replace(&store.blob_path(&record.measurements), "{}"),
        ];
        for (number, damage) in damages.iter().enumerate() {
            assert!(is_hit(store, "a"), "before damage {number}");
            damage();
            let Lookup::Damaged { paths, .. } = store.lookup(&key("a")) else { panic!("damage {number} not seen") };
            store.discard(&paths).unwrap();
            assert!(matches!(store.lookup(&key("a")), Lookup::Miss));
            publish(store, "a", "hello");
        }
        assert!(is_hit(store, "a"));
    });
}

#[test]
fn publishing_repairs_a_shared_corrupt_blob() {
    with_store(|store| {
        let record = publish(store, "a", "hello");
        let shared = store.blob_path(&store.manifest(&record.content).unwrap().files[0].sha256);
        replace(&shared, "SHARED BY ALL");
        publish(store, "b", "other");
        assert!(is_hit(store, "a") && is_hit(store, "b"));
    });
}

#[test]
fn truncated_and_scrambled_records_are_misses() {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    with_store(|store| {
        publish(store, "a", "hello");
        let path = store.record_path(&key("a"));
        let whole = fs::read(&path).unwrap();
        for _ in 0..200 {
            let cut = random.random_range(0..whole.len() - 2);
            fs::write(&path, &whole[..cut]).unwrap();
            assert!(!is_hit(store, "a"), "cut to {cut} bytes");
            let mut scrambled = whole.clone();
            scrambled[cut] = random.random();
            fs::write(&path, &scrambled).unwrap();
            // A scrambled record must not crash the lookup.
            let _ = store.lookup(&key("a"));
        }
        fs::write(&path, &whole).unwrap();
        assert!(is_hit(store, "a"));
    });
}

#[test]
fn folders_that_are_not_portable_are_refused() {
    let refused = |reason: &str, fill: &dyn Fn(&Path)| {
        with_store(|store| {
            let scratch = store.scratch("test").unwrap();
            fill(scratch.path());
            let error = store.publish(scratch.path(), &json!({})).unwrap_err();
            assert!(format!("{error:#}").contains(reason), "{error:#}");
        });
    };
    refused("no file", &|_| ());
    refused("links", &|dir| symlink("/etc/passwd", dir.join("link")).unwrap());
    refused("case", &|dir| ["a.png", "A.png"].iter().for_each(|name| fs::write(dir.join(name), "").unwrap()));
}

#[test]
fn manifests_that_lead_out_of_the_folder_are_refused() {
    let digest = crate::Digest::of(b"");
    for path in ["../up", "/etc/passwd", "a/../../b", "", "."] {
        let manifest = json!({ "version": 1, "files": [{ "path": path, "size_bytes": 0, "sha256": digest }] });
        assert!(super::Manifest::parse(manifest.to_string().as_bytes()).is_err(), "{path}");
    }
}

#[test]
fn a_newer_store_is_refused() {
    with_store(|store| {
        fs::write(store.root().join("FORMAT"), "2\n").unwrap();
        let message = Store::open(store.root()).unwrap_err().to_string();
        let message = message.replace(&store.root().display().to_string(), "STORE");
        insta::assert_snapshot!(message, @"the store has format 2, but this program supports format 1; use a newer program, or another folder with --store: STORE/FORMAT");
    });
}

#[test]
fn a_folder_whose_format_is_no_number_is_wrong_input() {
    with_store(|store| {
        fs::write(store.root().join("FORMAT"), "mp4\n").unwrap();
        let error = Store::open_read_only(store.root()).unwrap_err();
        let failure = error.downcast_ref::<Failure>().unwrap();
        assert_eq!(
            (failure.kind, &*failure.message),
            (FailureKind::BadInput, "this is not a store: FORMAT is not a number")
        );
    });
}

#[test]
fn foreign_folders_are_refused_and_left_alone() {
    let root = tempfile::tempdir().unwrap();
    let foreign = root.path().join("runs/my results.txt");
    fs::create_dir_all(foreign.parent().unwrap()).unwrap();
    fs::write(&foreign, "years of work").unwrap();
    for message in
        [Store::open(root.path()), Store::open_read_only(root.path())].map(|opened| opened.unwrap_err().to_string())
    {
        let message = message.replace(&fs::canonicalize(root.path()).unwrap().display().to_string(), "FOLDER");
        assert_eq!(message, "the folder is not empty and is not a store; choose another folder with --store: FOLDER");
    }
    assert_eq!(super::maintenance::files_below(root.path()).unwrap(), [foreign]);
}

#[test]
fn a_missing_store_reads_as_an_empty_one() {
    let root = tempfile::tempdir().unwrap();
    let place = root.path().join("store");
    let store = Store::open_read_only(&place).unwrap();
    assert!(!store.exists() && store.records().unwrap().is_empty() && matches!(store.lookup(&key("a")), Lookup::Miss));
    assert!(crate::runs::run_dirs(&store).unwrap().is_empty());
    assert!(!place.exists());
    // An empty folder becomes a store, and so does one in which another process is creating a store.
    fs::create_dir(&place).unwrap();
    fs::write(place.join(".FORMAT-begun"), "").unwrap();
    assert!(Store::open(&place).unwrap().exists() && Store::open_read_only(&place).unwrap().exists());
}

#[test]
fn processes_may_create_a_store_at_once() {
    let root = tempfile::tempdir().unwrap();
    let place = root.path().join("store");
    std::thread::scope(|scope| {
        let openers: Vec<_> = (0..8).map(|_| scope.spawn(|| Store::open(&place).map(|_| ()))).collect();
        openers.into_iter().for_each(|opener| opener.join().unwrap().unwrap());
    });
}

#[test]
fn result_links_follow_their_results() {
    with_store(|store| {
        let (old, new) = (publish(store, "a", "old"), publish(store, "b", "new"));
        let text = |name: &str| fs::read_to_string(store.result_link("r", name).join("text.txt")).ok();
        store.link_results("r", [("train/lego", &old.content), ("table", &old.content)]).unwrap();
        assert_eq!(text("train/lego").as_deref(), Some("old"));
        // A link replaces a folder and vice versa, without changing the artifacts.
        store.link_results("r", [("train", &new.content), ("table/lego", &new.content)]).unwrap();
        assert_eq!([text("train"), text("table/lego")], [Some("new".to_owned()), Some("new".to_owned())]);
        assert!(store.verify(false).unwrap().is_empty());
        assert!(!store.view(&old.content).unwrap().join("lego").exists());

        store.link_results("r", [("old", &old.content)]).unwrap();
        store.gc(&plan_of_b(), Duration::ZERO, false).unwrap();
        assert!(!store.result_link("r", "old").is_symlink());
        assert_eq!(text("train").as_deref(), Some("new"));
    });
}

#[test]
fn foreign_files_are_never_removed() {
    let root = tempfile::tempdir().unwrap();
    let store = Store::open(&root.path().join("store")).unwrap();
    let content = publish(&store, "a", "hello").content;
    let mine = root.path().join("w/notes/mine.txt");
    let kept = store.result_link("r", "train/kept/report.md");
    let linked = store.result_link("r", "elsewhere");
    for file in [&mine, &kept] {
        fs::create_dir_all(file.parent().unwrap()).unwrap();
        fs::write(file, "years of work").unwrap();
    }
    symlink(root.path().join("w"), &linked).unwrap();
    let absolute = root.path().join("w").display().to_string();
    let ways = [("../../w", "notes"), ("..", "../w/notes"), (absolute.as_str(), "notes"), ("", "../../w/notes")];
    let in_the_way = [("r", "train"), ("r", "train/kept/report.md"), ("r", "elsewhere"), ("r", "elsewhere/notes")];
    for (recipe, node) in ways.into_iter().chain(in_the_way) {
        store.link_results(recipe, [(node, &content)]).unwrap_err();
        assert!(
            [&mine, &kept].iter().all(|file| fs::read_to_string(file).unwrap() == "years of work"),
            "{recipe} {node}"
        );
    }
    store.gc(&Keep::default(), Duration::ZERO, false).unwrap();
    assert!(kept.exists() && mine.exists() && linked.is_symlink());
}

#[test]
fn errors_of_the_machine_name_the_file() {
    with_store(|store| {
        fs::remove_dir(store.root().join("runs")).unwrap();
        let message = crate::runs::run_dirs(store).unwrap_err().to_string();
        assert!(message.contains("/runs`: No such file"), "{message}");
    });
}

#[test]
fn verify_finds_planted_damage_and_repair_removes_it() {
    with_store(|store| {
        let record = publish(store, "a", "hello");
        publish(store, "b", "other");
        assert!(store.verify(false).unwrap().is_empty());
        replace(&store.blob_path(&store.manifest(&record.content).unwrap().files[1].sha256), "HELLO");
        let found: Vec<String> = store.verify(true).unwrap().into_iter().map(|damage| damage.message).collect();
        assert_eq!(found, ["blob is corrupt", "a: 1 of its blobs are missing or corrupt"]);
        assert!(store.verify(false).unwrap().is_empty());
        assert!(matches!(store.lookup(&key("a")), Lookup::Miss) && is_hit(store, "b"));
    });
}

#[test]
fn gc_keeps_planned_and_recent_results() {
    with_store(|store| {
        publish(store, "a", "hello");
        publish(store, "b", "other");
        let keep = plan_of_b();
        let young = store.gc(&keep, Duration::from_secs(3600), true).unwrap();
        assert!(young.jobs.is_empty());

        let planned = store.gc(&keep, Duration::ZERO, true).unwrap();
        assert_eq!(planned.jobs.iter().map(|job| job.0.as_str()).collect::<Vec<_>>(), ["a"]);
        assert!(is_hit(store, "a"), "a dry run removes nothing");

        let done = store.gc(&keep, Duration::ZERO, false).unwrap();
        assert_eq!((done.files, done.size_bytes), (planned.files, planned.size_bytes));
        assert!(matches!(store.lookup(&key("a")), Lookup::Miss) && is_hit(store, "b"));
        assert!(store.verify(false).unwrap().is_empty());
    });
}

#[test]
fn gc_keeps_the_folders_of_recent_runs() {
    with_store(|store| {
        let [old, new] = ["1", "2"].map(|run| store.run_dir(run).join("events.jsonl"));
        for file in [&old, &new] {
            fs::create_dir(file.parent().unwrap()).unwrap();
            fs::write(file, "").unwrap();
        }
        store.gc(&crate::runs::recent(store, 1).unwrap(), Duration::ZERO, false).unwrap();
        assert_eq!((old.exists(), new.exists()), (false, true));
    });
}

/// A run with one event.
fn add_run(store: &Store, event: &Event) {
    let dir = store.run_dir("1");
    fs::create_dir(&dir).unwrap();
    fs::write(dir.join("events.jsonl"), serde_json::to_string(event).unwrap() + "\n").unwrap();
}

#[test]
fn gc_keeps_results_that_recent_runs_found_in_the_store() {
    with_store(|store| {
        let [used, unused] = ["a", "b"].map(|name| publish(store, name, name));
        let result = NodeResult {
            key: Some(used.key.to_string()),
            content: Some(used.content),
            ..NodeResult::new(Outcome::Cached)
        };
        add_run(store, &Event::Finished { node: "a".into(), result });
        let keep = crate::runs::recent(store, 1).unwrap();
        let report = store.gc(&keep, Duration::ZERO, false).unwrap();
        assert_eq!(report.jobs.iter().map(|job| job.0.as_str()).collect::<Vec<_>>(), ["b"]);
        assert!(is_hit(store, "a") && !store.record_path(&unused.key).exists());
    });
}

#[test]
fn gc_keeps_the_checkpoints_of_recent_runs() {
    with_store(|store| {
        let [started, other] = ["a", "b"].map(|name| store.checkpoint_dir(key(name).as_str()).join("checkpoint.bin"));
        for file in [&started, &other] {
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, "half of a training").unwrap();
        }
        // The process was killed, so no event says how the job ended.
        add_run(store, &Event::Started { node: "a".into(), key: key("a").to_string(), threads: 1 });
        store.gc(&crate::runs::recent(store, 1).unwrap(), Duration::ZERO, false).unwrap();
        assert_eq!((started.exists(), other.exists()), (true, false));
    });
}

#[test]
fn gc_removes_nothing_while_a_record_cannot_be_read() {
    with_store(|store| {
        let [whole, other] = ["a", "b"].map(|name| publish(store, name, name));
        let path = store.record_path(&other.key);
        // E.g. of a newer version of the program, with a value that this one does not know.
        let text = fs::read_to_string(&path).unwrap();
        fs::remove_file(&path).unwrap();
        fs::write(&path, text.replacen('{', "{\"version\":99,", 1).replace("\"content\"", "\"contents\"")).unwrap();
        let error = store.gc(&Keep::default(), Duration::ZERO, false).unwrap_err().to_string();
        assert!(error.contains("nothing is removed") && error.contains(other.key.as_str()), "{error}");
        assert!(
            is_hit(store, "a") && store.blob_path(&whole.content).exists() && store.blob_path(&other.content).exists()
        );
        store.verify(true).unwrap();
        store.gc(&plan_of_b(), Duration::ZERO, false).unwrap();
        assert!(!store.blob_path(&whole.content).exists());
    });
}

#[test]
fn scratch_of_ended_processes_is_removed() {
    with_store(|store| {
        let mut process = std::process::Command::new("sleep").arg("60").spawn().unwrap();
        let left = store.root().join(format!("tmp/{}-job-x", crate::process::ProcessId::local(process.id()).tag()));
        let foreign = store.root().join("tmp/of another machine");
        let own = store.scratch("job").unwrap();
        fs::create_dir(&left).unwrap();
        fs::create_dir(&foreign).unwrap();
        drop(store.enter().unwrap());
        assert!(left.exists() && own.path().exists());
        process.kill().unwrap();
        process.wait().unwrap();
        drop(store.enter().unwrap());
        assert_eq!(
            (left.exists(), own.path().exists(), foreign.exists()),
            (cfg!(not(target_os = "linux")), true, true)
        );
    });
}

#[test]
fn a_store_in_use_is_not_locked_exclusively() {
    with_store(|store| {
        let entered = store.enter().unwrap();
        assert!(store.try_lock_exclusive().unwrap().is_none());
        drop(entered);
        let claim = store.try_claim(&key("a"), "run", 1).unwrap().unwrap();
        assert!(store.try_lock_exclusive().unwrap().is_none());
        drop(claim);
        assert!(store.try_lock_exclusive().unwrap().is_some());
    });
}

/// Overwrites a read-only file, like a failing disk or a careless user.
fn replace(path: &Path, text: &str) {
    fs::remove_file(path).unwrap();
    fs::write(path, text).unwrap();
}
