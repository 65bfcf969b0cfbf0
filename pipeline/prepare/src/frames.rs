//! The first step: frames of a video, or images of a folder.

use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use serde::Deserialize;
use walkdir::WalkDir;

use crate::error::{Result, bad, io};
use crate::request::Request;
use crate::steps::{Step, Steps, WORK, unfinished};
use crate::tools::{FFMPEG, FFPROBE};

/// The folder of images in the capture.
pub(crate) const IMAGES: &str = "images";
/// Extensions that both COLMAP and `sfm-import` read.
const EXTENSIONS: [&str; 5] = ["jpg", "jpeg", "png", "tif", "tiff"];
/// Maximum number of frames of a video if the user states none: ten seconds at 30 frames per second.
const MAX_FRAMES: u32 = 300;
/// Longest side of frames in pixels if the user states none: that of a Full HD video.
const MAX_SIDE: u32 = 1920;
/// Extensions of photos that must be converted to JPEG first.
const PHOTOS: [&str; 4] = ["heic", "heif", "dng", "webp"];

/// Makes `images/` and returns its frames per second, if they are known: images may be photos.
pub(crate) fn frames(steps: &mut Steps<'_>, request: &Request) -> Result<Option<f64>> {
    if request.input.is_dir() {
        of_folder(steps, request)?;
        return Ok(request.fps);
    }
    of_video(steps, request).map(Some)
}

/// The names of all images in a folder and in the folders below it, with `/`, in the order of their names. Hidden files are
/// skipped: archives of macOS have a file `._a.jpg` next to each `a.jpg`, which COLMAP cannot read.
pub(crate) fn image_names(dir: &Path) -> Vec<String> {
    files(dir, &EXTENSIONS)
}

fn files(dir: &Path, extensions: &[&str]) -> Vec<String> {
    let is_visible =
        |entry: &walkdir::DirEntry| entry.depth() == 0 || !entry.file_name().to_string_lossy().starts_with('.');
    let walk = WalkDir::new(dir).max_depth(2).sort_by_file_name().into_iter().filter_entry(is_visible).flatten();
    let has_extension = |path: &Path| {
        let extension = path.extension().map(|extension| extension.to_string_lossy().to_lowercase());
        extension.is_some_and(|extension| extensions.contains(&extension.as_str()))
    };
    let wanted = walk.filter(|entry| entry.path().is_file() && has_extension(entry.path()));
    wanted.map(|entry| entry.path().strip_prefix(dir).unwrap_or(entry.path()).display().to_string()).collect()
}

/// FFmpeg's description of a video.
#[derive(Deserialize)]
struct Probe {
    streams: Vec<Stream>,
    #[serde(default)]
    format: Container,
}

#[derive(Deserialize)]
struct Stream {
    avg_frame_rate: String,
    nb_read_packets: Option<String>,
}

#[derive(Default, Deserialize)]
struct Container {
    duration: Option<String>,
}

/// Rate and length of a video.
pub(crate) struct Video {
    /// Frames per second, as a fraction.
    pub(crate) rate: (u64, u64),
    /// Its length.
    pub(crate) secs: f64,
}

impl Video {
    /// Reads the video at `path`, which errors call `typed`.
    fn read(path: &Path, typed: &Path) -> Result<Self> {
        let entries = "stream=avg_frame_rate,nb_read_packets:format=duration";
        let arguments =
            ["-v", "error", "-select_streams", "v:0", "-count_packets", "-show_entries", entries, "-of", "json"];
        let arguments: Vec<&OsStr> = arguments.iter().map(OsStr::new).chain([path.as_os_str()]).collect();
        let text = FFPROBE.output(&arguments).map_err(|failure| failure.at(typed))?;
        let no_video = || bad("no video stream in this file").hint("name a video, or a folder of images").at(typed);
        let probe: Probe = serde_json::from_str(&text).map_err(|_| no_video())?;
        let stream = probe.streams.first().ok_or_else(no_video)?;
        let rate = stream.avg_frame_rate.split_once('/').ok_or_else(no_video)?;
        let rate = (rate.0.parse().unwrap_or(0), rate.1.parse().unwrap_or(0));
        if rate.0 == 0 || rate.1 == 0 {
            return Err(no_video());
        }
        let counted = stream.nb_read_packets.as_ref().and_then(|count| count.parse::<f64>().ok());
        let stated = probe.format.duration.and_then(|secs| secs.parse::<f64>().ok());
        let secs = stated.or(counted.map(|count| count * rate.1 as f64 / rate.0 as f64)).unwrap_or(0.0);
        Ok(Self { rate, secs })
    }

    /// Frames per second.
    fn fps(&self) -> f64 {
        self.rate.0 as f64 / self.rate.1 as f64
    }

    /// Refuses a rate above that of the video: FFmpeg would repeat frames.
    pub(crate) fn check_rate(&self, request: &Request) -> Result<()> {
        let own = self.fps();
        let Some(fps) = request.fps.filter(|fps| *fps > own * 1.01) else { return Ok(()) };
        let message =
            format!("--fps {fps} is above the {} frames per second of the video: frames would repeat", rounded(own));
        Err(bad(message).hint("omit --fps to take every frame, or choose a lower rate").at(&request.input))
    }

    /// The reason why fewer frames per second were extracted than the video has, if the user did not choose this.
    fn thinned(&self, request: &Request, fps: f64) -> String {
        let own = self.fps();
        if request.fps.is_some() || fps * 1.01 >= own {
            return String::new();
        }
        format!(" (the video has {}; --max-frames {})", rounded(own), request.max_frames.unwrap_or(MAX_FRAMES))
    }

    /// The rate of the frames to extract as text for FFmpeg, and as a number: the wanted one, or the video's own divided
    /// by the smallest whole number for which at most `most` frames fit into `secs`.
    pub(crate) fn rate_for(&self, wanted: Option<f64>, secs: f64, most: u32) -> (String, f64) {
        if let Some(fps) = wanted {
            return (fps.to_string(), fps);
        }
        let ((count, per), own) = (self.rate, self.fps());
        let divisor = ((secs * own - 0.5) / f64::from(most.max(1))).ceil().max(1.0) as u64;
        (format!("{count}/{}", per * divisor), own / divisor as f64)
    }
}

/// The arguments of FFmpeg between the input and the output.
fn ffmpeg_arguments(request: &Request, rate: &str) -> Vec<String> {
    let side = request.max_side.unwrap_or(MAX_SIDE);
    let scale = format!("scale=w='min(iw,{side})':h='min(ih,{side})':force_original_aspect_ratio=decrease:flags=area");
    let mut arguments = Vec::new();
    if let Some(end) = request.end_secs {
        arguments.extend(["-t".into(), (end - request.start_secs.unwrap_or(0.0)).to_string()]);
    }
    arguments.extend(["-vf".into(), format!("fps={rate},{scale}"), "-qscale:v".into(), "2".into()]);
    arguments
}

/// Extracts frames, numbered from 1.
fn of_video(steps: &mut Steps<'_>, request: &Request) -> Result<f64> {
    // FFmpeg would read a relative path with a colon as a protocol, and one with a leading hyphen as an option.
    let input = request.input.canonicalize().map_err(|error| io(&error, &request.input))?;
    let video = Video::read(&input, &request.input)?;
    let start = request.start_secs.unwrap_or(0.0);
    let secs = (request.end_secs.unwrap_or(video.secs).min(video.secs) - start).max(0.0);
    video.check_rate(request)?;
    let (rate, fps) = video.rate_for(request.fps, secs, request.max_frames.unwrap_or(MAX_FRAMES));
    let name = input.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let before: Vec<String> = request.start_secs.iter().flat_map(|start| ["-ss".into(), start.to_string()]).collect();
    let after = ffmpeg_arguments(request, &rate);
    let command = format!("ffmpeg {} -i {name} {} {IMAGES}/%05d.jpg", before.join(" "), after.join(" "));
    let expected = (secs * fps).round() as u64;
    let step = Step {
        name: "frames",
        commands: vec![command.replace("  ", " ")],
        tool: FFMPEG.version(),
        inputs: vec![("video", input.clone())],
        outputs: vec![IMAGES],
    };
    steps.run(step, |steps| {
        let scratch = steps.scratch(IMAGES)?;
        let mut ffmpeg = FFMPEG.command();
        ffmpeg.args(["-nostdin", "-v", "error", "-y"]).args(&before).arg("-i").arg(&input).args(&after);
        // FFmpeg runs in the folder of the capture, whose name may contain a percent sign.
        ffmpeg.arg(in_work(&format!("{}/%05d.jpg", unfinished(IMAGES))));
        let done = |_: &str| Some((image_names(&scratch).len() as u64, expected));
        steps.execute("frames", ffmpeg, &done)?;
        let count = image_names(&scratch).len();
        if count == 0 {
            return Err(bad("no frames between --start and --end").at(&request.input));
        }
        steps.publish(&scratch, IMAGES)?;
        let thinned = video.thinned(request, fps);
        Ok((Vec::new(), format!("{count} frames at {} per second{thinned}", rounded(fps))))
    })?;
    Ok(fps)
}

/// Links the images of a folder into the capture, or uses them in place.
fn of_folder(steps: &mut Steps<'_>, request: &Request) -> Result<()> {
    let mut input = request.input.canonicalize().map_err(|error| io(&error, &request.input))?;
    if input.join(IMAGES).is_dir() {
        input = input.join(IMAGES);
    }
    let (names, left_out) = named_images(&input)?;
    left_out.into_iter().for_each(|note| steps.note(note));
    let is_here = input == steps.dir.join(IMAGES);
    let command = if is_here { "use images".to_owned() } else { "link IMAGES images".into() };
    let inputs = vec![("images", input.clone())];
    let outputs = if is_here { Vec::new() } else { vec![IMAGES] };
    let step = Step { name: "frames", commands: vec![command], tool: Ok("pipeline".into()), inputs, outputs };
    steps.run(step, |steps| {
        let count = names.len();
        let sizes = sizes(&input, &names)?;
        if sizes.len() > 1 {
            let sizes: Vec<String> =
                sizes.iter().map(|((width, height), name)| format!("{width}×{height} (e.g. {name})")).collect();
            steps.note(format!("the images differ in size, but the import needs one size: {}", sizes.join(", ")));
        }
        if is_here {
            return Ok((Vec::new(), format!("{count} images, used in place")));
        }
        let scratch = steps.scratch(IMAGES)?;
        let how = link_all(&input, &names, &scratch)?;
        steps.publish(&scratch, IMAGES)?;
        Ok((Vec::new(), format!("{count} images, {how} from {}", input.display())))
    })
}

/// The names of the images in a folder, and a note about photos that COLMAP does not read. Refuses a folder without images.
fn named_images(input: &Path) -> Result<(Vec<String>, Option<String>)> {
    let is_no_mask = |name: &String| !name.starts_with("masks/");
    let names: Vec<String> = image_names(input).into_iter().filter(is_no_mask).collect();
    let photos: Vec<String> = files(input, &PHOTOS).into_iter().filter(is_no_mask).collect();
    match (names.is_empty(), photos.first()) {
        (true, first) => {
            let hint =
                first.map_or("name a video, or a folder of jpg, png or tif files", |_| "convert them to JPEG first");
            Err(bad("no images in this folder that COLMAP reads").hint(hint).at(input))
        }
        (false, None) => Ok((names, None)),
        (false, Some(first)) => {
            let why = "because COLMAP does not read them: convert them to JPEG";
            Ok((names, Some(format!("{} photos are left out, e.g. {first}, {why}", photos.len()))))
        }
    }
}

/// The different sizes of images, each with the name of one image. Refuses empty files.
pub(crate) fn sizes(dir: &Path, names: &[String]) -> Result<BTreeMap<(u32, u32), String>> {
    let mut sizes = BTreeMap::new();
    for name in names {
        let path = dir.join(name);
        if std::fs::metadata(&path).map_err(|error| io(&error, &path))?.len() == 0 {
            return Err(bad("the image is empty (0 bytes)").hint("copy it again, or remove it").at(&path));
        }
        // COLMAP reads some files whose size this decoder cannot read.
        if let Ok(size) = image_size(&path) {
            sizes.entry(size).or_insert_with(|| name.clone());
        }
    }
    Ok(sizes)
}

/// Width and height of an image, from its header.
pub(crate) fn image_size(path: &Path) -> Result<(u32, u32)> {
    let reader = image::ImageReader::open(path).and_then(image::ImageReader::with_guessed_format);
    let size = reader.map_err(image::ImageError::from).and_then(image::ImageReader::into_dimensions);
    size.map_err(|error| bad(format!("not an image: {error}")).at(path))
}

/// Links files into another folder; copies them if the file system cannot link. Returns the action in words.
pub(crate) fn link_all(from: &Path, names: &[String], to: &Path) -> Result<&'static str> {
    let mut how = "linked (hard links, no copies)";
    for name in names {
        let (source, target) = (from.join(name), to.join(name));
        let parent = target.parent().unwrap_or(to);
        std::fs::create_dir_all(parent).map_err(|error| io(&error, parent))?;
        // A hard link of a symbolic link would break when the capture moves.
        let source: PathBuf = source.canonicalize().map_err(|error| io(&error, &source))?;
        if std::fs::hard_link(&source, &target).is_err() {
            std::fs::copy(&source, &target).map_err(|error| io(&error, &source))?;
            how = "copied";
        }
    }
    Ok(how)
}

/// A rate with at most three decimals.
fn rounded(fps: f64) -> f64 {
    (fps * 1000.0).round() / 1000.0
}

/// The path of `name` in the work folder of a capture, relative to the capture.
pub(crate) fn in_work(name: &str) -> String {
    format!("{WORK}/{name}")
}
