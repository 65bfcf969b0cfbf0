//! Numbers of cameras, frames and images, compared with the files of each layout.

use std::path::Path;

use crate::{Finding, Manifest, compare};

/// Compares a folder that contains `files` with `stated` for this layout.
fn compared(layout: &str, stated: &str, files: &[String]) -> Finding {
    let text = format!(
        "manifest = 1\nname = \"set\"\ntitle = \"\"\nhomepage = \"\"\nsource = \"\"\nlicence = \"\"\naccess = \"open\"\n\
         format = \"x\"\nfolder = \"set\"\n[layout]\n{layout}\n[[scene]]\nname = \"lone\"\n{stated}\n"
    );
    let manifest = Manifest::parse(&text, Path::new("set.toml")).unwrap();
    let root = tempfile::tempdir().unwrap();
    let folder = root.path().join("set/lone");
    for file in files {
        std::fs::create_dir_all(folder.join(file).parent().unwrap()).unwrap();
        std::fs::write(folder.join(file), "").unwrap();
    }
    compare(&manifest, &manifest.scene[0], &folder)
}

/// The files of three cameras with four frames each.
fn files(name: impl Fn(u32, u32) -> String) -> Vec<String> {
    (0..3)
        .flat_map(|camera| (0..4).map(move |frame| (camera, frame)))
        .map(|(camera, frame)| name(camera, frame))
        .collect()
}

#[test]
fn cut_data_sets_are_found_in_each_layout() {
    type Name = fn(u32, u32) -> String;
    let layouts: [(&str, Name); 5] = [
        ("{scene}/images/{CC}/{FFFFFF}.jpg", |camera, frame| format!("images/{camera:02}/{frame:06}.JPG")),
        ("{scene}/ims/{camera}/{frame}.jpg", |camera, frame| format!("ims/cam-{camera}/{frame}.jpg")),
        ("{scene}/{scene}_undist_{FFFFF}_{CC}.png", |camera, frame| format!("lone_undist_{frame:05}_{camera:02}.png")),
        ("{scene}/hdImgs/00_{CC}/00_{CC}_{FFFFFFFF}.jpg", |camera, frame| {
            format!("hdImgs/00_{camera:02}/00_{camera:02}_{frame:08}.jpg")
        }),
        ("{scene}/cam{NN}/images/*.png", |camera, frame| format!("cam{camera:02}/images/x{frame}.png")),
    ];
    let stated = "cameras = 3\nframes = 4\nimages = 12";
    for (pattern, name) in layouts {
        let layout = format!("images = \"{pattern}\"");
        let mut files = files(name);
        files.push("images/README.txt".into());
        let of = |files: &[String]| compared(&layout, stated, files);
        assert_eq!(of(&files), Finding::Fine("12 images, 3 cameras, 4 frames".into()), "{pattern}");
        files.remove(5);
        let Finding::Wrong(wrong) = of(&files) else { panic!("a frame is missing: {pattern}") };
        assert!(wrong[0] == "11 images instead of 12" && wrong.len() == 2, "{wrong:?}");
        assert!(wrong[1].starts_with("3 frames of camera") && wrong[1].ends_with("1 instead of 4"), "{wrong:?}");
        files.truncate(4);
        let Finding::Wrong(wrong) = of(&files) else { panic!("cameras are missing: {pattern}") };
        assert!(wrong.contains(&"1 cameras instead of 3".to_owned()), "{wrong:?}");
    }
}

#[test]
fn longer_recordings_and_videos_are_fine() {
    let layout = "images = \"{scene}/ims/{CC}_{F}.jpg\"\nvideos = \"{scene}/cam{NN}.mp4\"";
    let longer = compared(layout, "frames = 3", &files(|camera, frame| format!("ims/{camera}_{frame}.jpg")));
    assert_eq!(longer, Finding::Fine("4 frames".into()));
    let videos: Vec<String> = (0..3).map(|camera| format!("cam{camera:02}.mp4")).collect();
    assert_eq!(compared(layout, "frames = 3\ncameras = 3", &videos), Finding::Fine("3 cameras".into()));
    assert!(matches!(compared(layout, "frames = 3\ncameras = 4", &videos), Finding::Wrong(_)));
    let empty = compared(layout, "frames = 3", &["other.txt".into()]);
    assert!(matches!(empty, Finding::Wrong(wrong) if wrong[0].contains("no file matches")));
}

/// Prose and alternatives in a layout match nothing, so nothing is compared.
#[test]
fn unknown_patterns_are_not_compared() {
    for pattern in ["{scene}/rgb/{1,2}x/*.png", "{scene}/images/*.png, if extracted", "{folder}/images"] {
        let found = compared(&format!("images = \"{pattern}\""), "images = 3", &["a.png".into()]);
        assert!(matches!(found, Finding::Fine(text) if text.contains("no numbers")), "{pattern}");
    }
}
