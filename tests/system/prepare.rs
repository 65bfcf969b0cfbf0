//! `prepare` as its users call it: with fake programs in `PATH` that record their arguments, and with FFmpeg and COLMAP
//! where they are installed.

use std::os::unix::fs::PermissionsExt as _;
use std::path::{Path, PathBuf};
use std::process::Command;

use support::fakes::Fake;

use crate::product::{Ended, program};

/// Frames of the fake video.
const FRAMES: usize = 12;

const FFPROBE: &str = r#"echo "ffprobe $*" >> CALLS
[ "$1" = -version ] && { echo 'ffprobe version 9-fake'; exit; }
echo '{"streams":[{"avg_frame_rate":"30000/1001","nb_read_packets":"12"}],"format":{"duration":"0.4004"}}'"#;

/// Writes the frames that the test made.
const FFMPEG: &str = r#"[ "$1" = -version ] && { echo 'ffmpeg version 9-fake'; exit; }
echo "ffmpeg $*" >> CALLS
for out in "$@"; do :; done
cp FRAMES/* "$(dirname "$out")""#;

/// Writes a database, and models of which the second is the largest.
const COLMAP: &str = r#"case "$1" in -h|help) echo 'COLMAP 9.9-fake'; echo '(Commit x without CUDA)'; exit;; esac
[ "$2" = -h ] && { echo '--SiftExtraction.use_gpu --FeatureMatching.use_gpu'; exit; }
echo "colmap $*" >> CALLS
while [ $# -gt 0 ]; do
  case "$1" in --database_path) db=$2;; --output_path) out=$2;; --Mapper.init_min_tri_angle) patient=1;; esac
  verb=${verb:-$1}; shift
done
case $verb in
  feature_extractor) echo 'Processed file [12/12]'; echo '  Features:        99'; echo features > "$db";;
  *_matcher) echo matches >> "$db";;
  mapper) [ -e FAIL ] && exit 1
    echo changed >> "$db"; mkdir -p "$out/0" "$out/1"
    cp SMALL/* "$out/0"; cp SMALL/* "$out/1"; [ -e FEW ] && [ -z "$patient" ] || cp LARGE/* "$out/1"
    echo 'Registering image #3 (12)';;
esac"#;

/// A folder with fake programs and a fake video.
struct Bench {
    dir: tempfile::TempDir,
}

impl Bench {
    fn new() -> Self {
        let bench = Self { dir: tempfile::tempdir().unwrap() };
        let rig = Fake { size: (48, 32), ..Fake::small(FRAMES, 1) };
        rig.write_frames(|camera, _| bench.path(&format!("frames/{:05}.jpg", camera + 1)));
        std::fs::write(bench.path("clip.mp4"), "a video").unwrap();
        write_model(&bench.path("small"), &rig, 4);
        write_model(&bench.path("large"), &rig, FRAMES);
        for (name, script) in [("ffprobe", FFPROBE), ("ffmpeg", FFMPEG), ("colmap", COLMAP)] {
            bench.install(name, script);
        }
        for name in ["sh", "cp", "dirname", "basename", "mkdir", "sleep"] {
            let folders = ["/bin", "/usr/bin"].map(|folder| Path::new(folder).join(name));
            let found = folders.into_iter().find(|path| path.exists()).expect("a Unix system has this program");
            std::os::unix::fs::symlink(found, bench.path("bin").join(name)).unwrap();
        }
        bench
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    fn install(&self, name: &str, script: &str) {
        let path = self.path("bin").join(name);
        std::fs::create_dir_all(self.path("bin")).unwrap();
        let words = [("CALLS", "calls"), ("FRAMES", "frames"), ("SMALL", "small"), ("LARGE", "large"), ("FEW", "few")];
        let words = words.iter().chain([&("FAIL", "fail")]);
        let script = words.fold(script.to_owned(), |script, (word, name)| {
            script.replace(word, &self.path(name).display().to_string())
        });
        std::fs::write(&path, format!("#!/bin/sh\n{script}\n")).unwrap();
        std::fs::set_permissions(&path, std::fs::Permissions::from_mode(0o755)).unwrap();
    }

    fn command(&self, arguments: &[&str]) -> Command {
        let mut command = program(&["prepare"]);
        command.args(arguments).args(["--out", "mine"]).env("PATH", self.path("bin")).current_dir(self.dir.path());
        command
    }

    fn prepare(&self, arguments: &[&str]) -> Ended {
        Ended::of(self.command(arguments))
    }

    /// The calls of the fake programs that wrote something since the last time.
    fn calls(&self) -> Vec<String> {
        let text = std::fs::read_to_string(self.path("calls")).unwrap_or_default();
        let _ = std::fs::remove_file(self.path("calls"));
        let root = self.dir.path().canonicalize().unwrap().display().to_string();
        let lines = text.lines().filter(|line| !line.starts_with("ffprobe"));
        lines.map(|line| line.replace(&root, "DIR")).collect()
    }
}

/// A binary COLMAP model of the first cameras of a rig, with a few points.
fn write_model(dir: &Path, rig: &Fake, images: usize) {
    std::fs::create_dir_all(dir).unwrap();
    let lens = rig.camera(0);
    let mut cameras =
        [1_u64.to_le_bytes().to_vec(), 1_u32.to_le_bytes().to_vec(), 0_u32.to_le_bytes().to_vec()].concat();
    cameras.extend([u64::from(rig.size.0), u64::from(rig.size.1)].iter().flat_map(|size| size.to_le_bytes()));
    cameras.extend([lens.focal, lens.center.x, lens.center.y].iter().flat_map(|value| value.to_le_bytes()));
    std::fs::write(dir.join("cameras.bin"), cameras).unwrap();
    let mut bytes = (images as u64).to_le_bytes().to_vec();
    for index in 0..images {
        let camera = rig.camera(index);
        let angle = turn(&camera.rotation.to_cols_array());
        bytes.extend((index as u32 + 1).to_le_bytes());
        bytes.extend(angle.iter().chain(&camera.translation.to_array()).flat_map(|value| value.to_le_bytes()));
        bytes.extend(1_u32.to_le_bytes());
        bytes.extend(format!("{:05}.jpg\0", index + 1).bytes());
        bytes.extend(0_u64.to_le_bytes());
    }
    std::fs::write(dir.join("images.bin"), bytes).unwrap();
    let mut bytes = 200_u64.to_le_bytes().to_vec();
    for index in 0..200_u64 {
        let at = |factor: f64| (index as f64 * factor).sin();
        bytes.extend(index.to_le_bytes());
        bytes.extend([at(1.3), at(2.1), 0.5 * at(0.7)].iter().flat_map(|value| value.to_le_bytes()));
        bytes.extend([200, 100, 50]);
        bytes.extend(0.5_f64.to_le_bytes());
        bytes.extend(0_u64.to_le_bytes());
    }
    std::fs::write(dir.join("points3D.bin"), bytes).unwrap();
}

/// The quaternion (w, x, y, z) of a rotation, given column by column, of less than half a turn.
fn turn(c: &[f64; 9]) -> [f64; 4] {
    let w = 0.5 * (1.0 + c[0] + c[4] + c[8]).sqrt();
    [w, (c[5] - c[7]) / (4.0 * w), (c[6] - c[2]) / (4.0 * w), (c[1] - c[3]) / (4.0 * w)]
}

/// Masks for the images, with a set square.
fn write_masks(dir: &Path, first: usize) {
    std::fs::create_dir_all(dir).unwrap();
    for index in 0..FRAMES {
        let is_set = |column, row| (20..26).contains(&column) && (10..20).contains(&row);
        let path = dir.join(format!("{:05}.png", index + first));
        support::fakes::write_mask(&path, (48, 32), is_set);
    }
}

#[test]
fn a_video_becomes_a_capture_and_is_kept() {
    let bench = Bench::new();
    let first = bench.prepare(&["clip.mp4", "--start", "0.1"]);
    let calls = bench.calls();
    assert_eq!(calls.len(), 4, "{calls:?}\n{}", first.stderr);
    let scale = "scale=w='min(iw,1920)':h='min(ih,1920)':force_original_aspect_ratio=decrease:flags=area";
    assert_eq!(
        calls[0],
        format!(
            "ffmpeg -nostdin -v error -y -ss 0.1 -i DIR/clip.mp4 -vf fps=30000/1001,{scale} -qscale:v 2 \
             .prepare/images.partial/%05d.jpg"
        )
    );
    assert_eq!(
        calls[1],
        "colmap feature_extractor --image_path images --ImageReader.camera_model SIMPLE_RADIAL --ImageReader.single_camera 1 \
         --database_path DIR/mine/.prepare/features.partial/features.db --SiftExtraction.use_gpu 0"
    );
    assert!(
        calls[2].starts_with("colmap exhaustive_matcher --database_path")
            && calls[2].ends_with("FeatureMatching.use_gpu 0")
    );
    assert!(calls[3].starts_with("colmap mapper --image_path images --Mapper.min_model_size 3 --database_path"));
    assert!(first.stderr.contains("12 of 12 images have a pose, the largest of 2 reconstructions"), "{}", first.stderr);
    assert!(first.stderr.contains("differ from run to run: keep sparse/0"), "{}", first.stderr);
    let next = first.ok();
    assert!(next.contains("inspect") && next.contains("train/mine/deformable4dgs/0 --views test"), "{next}");

    let second = bench.prepare(&["clip.mp4", "--start", "0.1"]);
    assert!(second.stderr.contains("nothing had to run"), "{}", second.stderr);
    assert_eq!((bench.calls(), second.ok()), (Vec::new(), next));

    let forced = bench.prepare(&["clip.mp4", "--start", "0.1", "--force", "matches"]).ok();
    assert!(bench.calls().len() == 1 && !forced.is_empty(), "equal matches keep the model");
    bench.prepare(&["clip.mp4", "--start", "0.1", "--camera-model", "opencv"]).ok();
    let verbs: Vec<String> = bench.calls().iter().map(|call| call.split(' ').nth(1).unwrap().to_owned()).collect();
    assert_eq!(verbs, ["feature_extractor"], "equal features keep what follows");
    std::fs::write(bench.path("clip.mp4"), "another video").unwrap();
    bench.prepare(&["clip.mp4", "--start", "0.1"]).ok();
    assert!(bench.calls()[0].starts_with("ffmpeg"));
}

#[test]
fn a_prepared_capture_with_masks_has_a_recipe_that_plans() {
    let bench = Bench::new();
    write_masks(&bench.path("drawn"), 1);
    std::fs::write(
        bench.path("estimators.toml"),
        "[[estimator]]\nname = \"any-depth\"\nkind = \"depth\"\ncommand = \"for f in {frames}/*; do : > {out}/$(basename $f .jpg).npy; done\"\n\
         import = { kind = \"affine-depth\" }\n",
    )
    .unwrap();
    let arguments = ["clip.mp4", "--masks", "drawn", "--estimators", "estimators.toml"];
    bench.prepare(&arguments).ok();
    let calls = bench.calls();
    assert!(calls[1].contains("--ImageReader.mask_path .prepare/colmap-masks"), "{calls:?}");
    assert!(calls[1].contains("SIMPLE_PINHOLE"), "maps of the frames need a pinhole: {calls:?}");
    let again = bench.prepare(&arguments);
    assert!(
        again.stderr.contains("kept  any-depth: 12 files in maps/depth") && bench.calls().is_empty(),
        "{}",
        again.stderr
    );

    let mut inspect = program(&["inspect", "mine", "--recipe"]);
    inspect.current_dir(bench.dir.path());
    let recipe = Ended::of(inspect).ok();
    insta::assert_snapshot!(recipe.replace(&bench.dir.path().canonicalize().unwrap().display().to_string(), "DIR"));
    std::fs::write(bench.path("own.toml"), recipe).unwrap();
    let mut plan = program(&["plan", "own.toml", "--data-root", "."]);
    plan.current_dir(bench.dir.path());
    let plan = Ended::of(plan).ok();
    assert!(plan.contains("train/mine/vcgs/0") && plan.contains("seed-from-masks"), "{plan}");
}

#[test]
fn a_prepared_capture_with_flow_alone_has_a_recipe_that_plans() {
    let bench = Bench::new();
    std::fs::write(
        bench.path("estimators.toml"),
        "[[estimator]]\nname = \"any-flow\"\nkind = \"flow\"\n\
         command = \"for f in {frames}/*; do : > {out}/$(basename $f .jpg).flo; done\"\n",
    )
    .unwrap();
    bench.prepare(&["clip.mp4", "--estimators", "estimators.toml"]).ok();
    let mut inspect = program(&["inspect", "mine", "--recipe"]);
    inspect.current_dir(bench.dir.path());
    let recipe = Ended::of(inspect).ok();
    let priors = "[nodes.priors.params]\nsource = \"files\"\nfolder = \"{scene}/maps\"\n";
    let depth = "# Depth is interpolated between the points of the capture.\nfill_depth = true\n";
    assert!(recipe.contains(&format!("{priors}{depth}")) && recipe.contains("Found: flow."), "{recipe}");
    std::fs::write(bench.path("own.toml"), recipe).unwrap();
    let mut plan = program(&["plan", "own.toml", "--data-root", "."]);
    plan.current_dir(bench.dir.path());
    let plan = Ended::of(plan).ok();
    assert!(plan.contains("train/mine/vcgs/0") && plan.contains("seed-from-masks"), "{plan}");
}

#[test]
fn a_killed_preparation_continues_with_its_step() {
    let bench = Bench::new();
    let slow = COLMAP
        .replace("mapper)", "mapper) [ -e SLOW ] || sleep 60;")
        .replace("SLOW", &bench.path("slow").display().to_string());
    bench.install("colmap", &slow);
    let mut child = bench.command(&["clip.mp4"]).spawn().unwrap();
    let matched = bench.path("mine/.prepare/mapping.partial");
    while !matched.is_dir() {
        assert!(child.try_wait().unwrap().is_none(), "the preparation ended early");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    child.kill().unwrap();
    child.wait().unwrap();
    std::fs::write(bench.path("slow"), "").unwrap();
    bench.calls();
    let ended = bench.prepare(&["clip.mp4"]);
    assert!(ended.stderr.contains("kept  matches") && ended.stderr.contains("1 step ran"), "{}", ended.stderr);
    ended.ok();
    assert_eq!(bench.calls().len(), 1);
}

#[test]
fn a_folder_of_images_is_linked_or_used_in_place() {
    let bench = Bench::new();
    let linked = bench.prepare(&["frames", "--until", "frames"]);
    assert!(linked.stderr.contains("12 images, linked (hard links, no copies)"), "{}", linked.stderr);
    assert!(bench.path("mine/images/00012.jpg").is_file());
    let in_place = bench.prepare(&["mine/images", "--until", "frames"]);
    assert!(in_place.stderr.contains("12 images, used in place"), "{}", in_place.stderr);
    assert!(bench.calls().is_empty());
}

#[test]
fn poor_reconstructions_are_tried_again_and_refused() {
    let bench = Bench::new();
    std::fs::write(bench.path("few"), "").unwrap();
    let ended = bench.prepare(&["clip.mp4"]);
    assert!(ended.stderr.contains("trying again") && ended.stderr.contains("12 of 12 images"), "{}", ended.stderr);
    assert!(bench.calls().last().unwrap().contains("--Mapper.init_min_tri_angle 4"));
    std::fs::write(bench.path("fail"), "").unwrap();
    let refused = bench.prepare(&["clip.mp4", "--force", "mapping"]);
    assert_eq!(refused.code, 3, "{}", refused.stderr);
    assert!(
        refused.stderr.contains("only 0 of 12 images have a pose") && refused.stderr.contains("--masks"),
        "{}",
        refused.stderr
    );
}

#[test]
fn mistakes_are_named_with_what_to_do() {
    let bench = Bench::new();
    let mut texts = String::new();
    let mut refuse = |title: &str, arguments: &[&str]| {
        let ended = bench.prepare(arguments);
        // A missing program is a failure of the machine.
        let code = if title.starts_with("without") { 13 } else { 3 };
        assert_eq!(ended.code, code, "{title}: {}", ended.stderr);
        let root = bench.dir.path().canonicalize().unwrap().display().to_string();
        let lines = ended.stderr.lines().skip_while(|line| !line.starts_with("error"));
        texts += &format!("{title}\n{}\n\n", lines.collect::<Vec<_>>().join("\n").replace(&root, "DIR"));
    };
    write_masks(&bench.path("from-zero"), 0);
    refuse("masks numbered from 0", &["clip.mp4", "--masks", "from-zero"]);
    refuse("unknown step", &["clip.mp4", "--force", "mapp"]);
    refuse("no input", &["nothing.mp4"]);
    std::fs::write(bench.path("bad.toml"), "[[estimator]]\nname = \"a\"\nkind = \"depht\"\ncommand = \"x\"\n").unwrap();
    refuse("a mistyped kind", &["clip.mp4", "--estimators", "bad.toml"]);
    std::fs::write(bench.path("bad.toml"), "[[estimator]]\nname = \"a\"\nkind = \"depth\"\ncommand = \"x {out}\"\n")
        .unwrap();
    refuse("no place for frames", &["clip.mp4", "--estimators", "bad.toml"]);
    let fails =
        "[[estimator]]\nname = \"a\"\nkind = \"depth\"\ncommand = \"echo no weights, {frames} {out} >&2; exit 7\"\n";
    std::fs::write(bench.path("bad.toml"), fails).unwrap();
    refuse("an estimator that fails", &["clip.mp4", "--estimators", "bad.toml"]);
    std::fs::remove_file(bench.path("bin/colmap")).unwrap();
    std::fs::remove_dir_all(bench.path("mine")).unwrap();
    refuse("without COLMAP", &["clip.mp4"]);
    std::fs::remove_dir_all(bench.path("mine")).unwrap();
    std::fs::create_dir_all(bench.path("mine/images")).unwrap();
    refuse("images of another origin", &["clip.mp4"]);
    std::fs::remove_file(bench.path("bin/ffprobe")).unwrap();
    refuse("without FFmpeg", &["clip.mp4"]);
    insta::assert_snapshot!(texts);
}

/// FFmpeg and COLMAP themselves, on a video of a textured ball before a wall, up to a sheet of renders.
#[test]
fn real_programs_make_a_capture_that_trains() {
    for (name, argument) in [("ffmpeg", "-version"), ("ffprobe", "-version"), ("colmap", "-h")] {
        if Command::new(name).arg(argument).output().is_err() {
            return support::skip(&format!("{name} is not installed"));
        }
    }
    let dir = tempfile::tempdir().unwrap();
    let rig = Fake { size: (320, 240), ..Fake::small(FRAMES, 1) };
    rig.write_frames(|camera, _| dir.path().join(format!("frames/{camera:03}.png")));
    let mut encode = Command::new("ffmpeg");
    encode.current_dir(dir.path()).args(["-v", "error", "-framerate", "10", "-i", "frames/%03d.png", "-q:v", "1"]);
    assert!(encode.args(["-c:v", "mpeg4", "clip.mp4"]).status().unwrap().success());
    let prepare = || {
        let mut command = program(&["prepare", "clip.mp4", "--out", "mine"]);
        command.current_dir(dir.path());
        Ended::of(command)
    };
    let first = prepare();
    assert!(first.stderr.contains("12 frames at 10 per second"), "{}", first.stderr);
    assert!(first.stderr.contains("of 12 images have a pose"), "{}", first.stderr);
    first.ok();
    assert!(prepare().stderr.contains("nothing had to run"));
    let call = |arguments: &[&str]| {
        let mut command = program(arguments);
        command.current_dir(dir.path());
        Ended::of(command).ok()
    };
    let recipe = call(&["inspect", "mine", "--recipe"]);
    assert!(recipe.contains("fps = 10.0"), "{recipe}");
    std::fs::write(dir.path().join("own.toml"), recipe).unwrap();
    let data = ["--data-root", ".", "--store", "store"];
    let tiny = [
        "axes.method=[\"static3dgs\"]",
        "nodes.train.params.schedule_scale=0.02",
        "nodes.train.params.curve.points=0",
        "nodes.capture.params.width=80",
    ];
    let tiny: Vec<&str> = tiny.into_iter().flat_map(|value| ["-s", value]).collect();
    call(&[&["run", "own.toml"][..], &data, &tiny].concat());
    let sheet = ["render", "own.toml", "train/mine/static3dgs/0", "--views", "test", "--truth", "--sheet", "clip.png"];
    call(&[&sheet[..], &data, &tiny].concat());
    let sheet = std::fs::read(dir.path().join("clip.png")).unwrap();
    let [width, height] = [16, 20].map(|at| u32::from_be_bytes(sheet[at..at + 4].try_into().unwrap()));
    assert!(width == 2 * 80 && height >= 50, "{width}×{height}: the truth and a render of every held-out frame");
}
