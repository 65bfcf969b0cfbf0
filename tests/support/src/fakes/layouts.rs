//! The layouts of public data sets.

use std::path::Path;

use glam::{DMat3, DVec3};
use serde_json::{Value, json};

use super::opencv_yaml::{entry, header, matrix, vector};
use super::{Fake, FakeCamera, write};

/// Near and far depth in rows of `poses_bounds.npy`.
const DEPTH_RANGE: [f64; 2] = [2.0, 8.0];
/// Cameras of the Panoptic Studio that are held out.
const PANOPTIC_TEST: [usize; 4] = [0, 10, 15, 30];
/// Cameras of NVIDIA's rig.
const NVIDIA_CAMERAS: usize = 12;

impl FakeCamera {
    fn matrix(&self) -> DMat3 {
        let (focal, center) = (self.focal, self.center);
        DMat3::from_cols_array(&[focal, 0.0, 0.0, 0.0, focal, 0.0, center.x, center.y, 1.0])
    }

    /// The row of `poses_bounds.npy`.
    fn llff_row(&self, (width, height): (u32, u32)) -> [f64; 17] {
        let axes = self.rotation.transpose();
        let (right, down, back) = (axes.x_axis, axes.y_axis, -axes.z_axis);
        let (at, [near, far]) = (self.position(), DEPTH_RANGE);
        let (height, width) = (f64::from(height), f64::from(width));
        let row = |axis: usize, last: f64| [down[axis], right[axis], back[axis], at[axis], last];
        let rows = [row(0, height), row(1, width), row(2, self.focal)].concat();
        std::array::from_fn(|index| [&rows[..], &[near, far]].concat()[index])
    }
}

/// Writes a `.npy` file of doubles with this shape.
fn write_npy(path: &Path, shape: &str, values: &[f64]) {
    let header = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
    let mut bytes = [&b"\x93NUMPY\x01\x00\x76\x00"[..], format!("{header:<117}\n").as_bytes()].concat();
    values.iter().for_each(|value| bytes.extend(value.to_le_bytes()));
    write(path, bytes);
}

impl Fake {
    pub(super) fn write_poses_bounds(&self, dir: &Path, cameras: impl Iterator<Item = usize>) {
        let rows: Vec<[f64; 17]> = cameras.map(|index| self.camera(index).llff_row(self.size)).collect();
        write_npy(&dir.join("poses_bounds.npy"), &format!("({}, 17)", rows.len()), rows.as_flattened());
    }

    /// EasyMocap and EasyVolcap: `intri.yml`, `extri.yml`, `images/CAMERA/FRAME.jpg`, cameras named 00, 01, ….
    pub fn easy_volcap(&self, dir: &Path) {
        let names: Vec<String> = (0..self.cameras).map(|index| format!("{index:02}")).collect();
        let (mut intri, mut extri) = (header(&names), header(&names));
        for (index, name) in names.iter().enumerate() {
            let camera = self.camera(index);
            intri += &matrix(&format!("K_{name}"), camera.matrix());
            intri += &entry(&format!("D_{name}"), [5, 1], &[0.0; 5]);
            intri += &format!("H_{name}: {}.\nW_{name}: {}.\n", self.size.1, self.size.0);
            extri += &vector(&format!("R_{name}"), rotation_vector(camera.rotation));
            extri += &matrix(&format!("Rot_{name}"), camera.rotation);
            extri += &vector(&format!("T_{name}"), camera.translation);
        }
        write(&dir.join("intri.yml"), intri);
        write(&dir.join("extri.yml"), extri);
        self.write_frames(|camera, frame| dir.join(format!("images/{camera:02}/{frame:06}.jpg")));
    }

    /// Dynamic 3D Gaussians: `train_meta.json`, `test_meta.json`, `ims/CAMERA/FRAME.jpg`; cameras 0, 10, 15 and 30 are for
    /// testing.
    pub fn panoptic_sports(&self, dir: &Path) {
        for (name, is_test) in [("train_meta.json", false), ("test_meta.json", true)] {
            let cameras: Vec<usize> = (0..self.cameras).filter(|it| PANOPTIC_TEST.contains(it) == is_test).collect();
            let each = |item: &dyn Fn(usize, usize) -> Value| -> Vec<Vec<Value>> {
                (0..self.frames).map(|frame| cameras.iter().map(|camera| item(*camera, frame)).collect()).collect()
            };
            let pose = |camera: usize| {
                let FakeCamera { rotation, translation, .. } = self.camera(camera);
                let rows = rotation.transpose().to_cols_array_2d();
                let row = |axis: usize| [rows[axis][0], rows[axis][1], rows[axis][2], translation[axis]];
                json!([row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]])
            };
            let lens = |camera: usize| json!(self.camera(camera).matrix().transpose().to_cols_array_2d());
            let meta = json!({
                "w": self.size.0, "h": self.size.1,
                "k": each(&|camera, _| lens(camera)),
                "w2c": each(&|camera, _| pose(camera)),
                "fn": each(&|camera, frame| json!(format!("{camera}/{frame:06}.jpg"))),
                "cam_id": each(&|camera, _| json!(camera)),
            });
            write(&dir.join(name), meta.to_string());
        }
        self.write_frames(|camera, frame| dir.join(format!("ims/{camera}/{frame:06}.jpg")));
    }

    /// The Panoptic Studio's toolbox: `calibration_x.json` in centimetres, `hdImgs/00_CC/00_CC_FFFFFFFF.jpg`, and a camera of
    /// low definition, without frames.
    pub fn panoptic_studio(&self, dir: &Path) {
        let stated = |index: usize, kind: &str| {
            let camera = self.camera(index);
            let t = (100.0 * camera.translation).to_array().map(|value| [value]);
            json!({
                "name": format!("{:02}_{index:02}", u8::from(kind == "vga")), "type": kind, "node": index, "panel": 0,
                "resolution": [self.size.0, self.size.1],
                "K": camera.matrix().transpose().to_cols_array_2d(), "distCoef": [0.0, 0.0, 0.0, 0.0, 0.0],
                "R": camera.rotation.transpose().to_cols_array_2d(), "t": t,
            })
        };
        let high = (0..self.cameras).map(|index| stated(index, "hd"));
        let cameras: Vec<Value> = std::iter::once(stated(0, "vga")).chain(high).collect();
        let calibration = json!({ "calibDataSource": "a fake", "cameras": cameras });
        write(&dir.join("calibration_x.json"), calibration.to_string());
        self.write_frames(|camera, frame| dir.join(format!("hdImgs/00_{camera:02}/00_{camera:02}_{frame:08}.jpg")));
    }

    /// Technicolor: `cameras_parameters.txt` and `SCENE_undist_FFFFF_CC.png` with frames from 51 on.
    pub fn technicolor(&self, dir: &Path) {
        let line = |index: usize| {
            let FakeCamera { rotation, translation: t, focal, center } = self.camera(index);
            let q = glam::DQuat::from_mat3(&rotation);
            let (x, y) = (center.x, center.y);
            format!("{focal} {x} {y} 1 0 -0.03 0.1 {} {} {} {} {} {} {}\n", q.w, q.x, q.y, q.z, t.x, t.y, t.z)
        };
        let lines: String = (0..self.cameras).map(line).collect();
        let titles = "f cu cv ar sk d1 d2 qw qx qy qz tx ty tz\n";
        write(&dir.join("cameras_parameters.txt"), format!("{titles}{lines}"));
        self.write_frames(|camera, frame| dir.join(format!("Birthday_undist_{:05}_{camera:02}.png", 51 + frame)));
    }

    /// COLMAP: a text model of a pinhole without points in `sparse/0`, and `images/FFFF.png` of one moving camera.
    pub fn colmap(&self, dir: &Path) {
        let (width, height) = self.size;
        let moving = Self { cameras: self.frames, ..self.clone() };
        let FakeCamera { focal, center, .. } = moving.camera(0);
        let camera = format!("1 PINHOLE {width} {height} {focal} {focal} {} {}\n", center.x, center.y);
        let pose = |index: usize| {
            let FakeCamera { rotation, translation: t, .. } = moving.camera(index);
            let q = glam::DQuat::from_mat3(&rotation);
            let (x, y, z) = (t.x, t.y, t.z);
            format!("{} {} {} {} {} {x} {y} {z} 1 {index:04}.png\n\n", index + 1, q.w, q.x, q.y, q.z)
        };
        write(&dir.join("sparse/0/cameras.txt"), camera);
        write(&dir.join("sparse/0/images.txt"), (0..self.frames).map(pose).collect::<String>());
        write(&dir.join("sparse/0/points3D.txt"), "# none\n");
        for index in 0..self.frames {
            let image = dir.join(format!("images/{index:04}.png"));
            super::make_folder_of(&image);
            moving.image(index, index).save(image).expect("the temporary folder can be written");
        }
    }

    /// Neural 3D Video with extracted frames: `poses_bounds.npy` and `camNN/images/FFFF.jpg`.
    pub fn neural_3d_video(&self, dir: &Path) {
        self.write_poses_bounds(dir, 0..self.cameras);
        self.write_frames(|camera, frame| dir.join(format!("cam{camera:02}/images/{frame:04}.jpg")));
    }

    /// LLFF: `poses_bounds.npy` and one photo per camera in `images`.
    pub fn llff(&self, dir: &Path) {
        self.write_poses_bounds(dir, 0..self.cameras);
        let photos = Self { frames: 1, ..self.clone() };
        photos.write_frames(|camera, _| dir.join(format!("images/IMG_{camera:04}.png")));
    }

    /// NVIDIA's Dynamic Scenes: `poses_bounds.npy` with a row per instant, one image per instant in `images`, and those of
    /// all twelve cameras in `mv_images`.
    pub fn nvidia(&self, dir: &Path) {
        let rig = Self { cameras: NVIDIA_CAMERAS, ..self.clone() };
        rig.write_poses_bounds(dir, (0..rig.frames).map(|instant| instant % NVIDIA_CAMERAS));
        rig.write_frames(|camera, frame| dir.join(format!("mv_images/{frame:05}/cam{:02}.jpg", camera + 1)));
        for instant in 0..rig.frames {
            let image = dir.join(format!("images/{instant:05}.png"));
            super::make_folder_of(&image);
            rig.image(instant % NVIDIA_CAMERAS, instant).save(image).expect("the temporary folder can be written");
        }
    }

    /// Nerfies: `camera/ID.json`, `metadata.json`, `dataset.json`, `rgb/Nx/ID.png`. The first camera trains and the second
    /// one tests; with a single camera, no view is held out (an interpolation capture).
    pub fn nerfies(&self, dir: &Path, reduction: u32) {
        let id = |camera: usize, frame: usize| format!("{camera}_{frame:05}");
        let all = |camera: usize| (0..self.frames).map(move |frame| id(camera, frame)).collect::<Vec<_>>();
        let ids: Vec<String> = (0..self.cameras).flat_map(all).collect();
        let (train, val) = if self.cameras > 1 { (all(0), all(1)) } else { (Vec::new(), Vec::new()) };
        let dataset = json!({ "count": ids.len(), "ids": ids, "train_ids": train, "val_ids": val });
        write(&dir.join("dataset.json"), dataset.to_string());
        write(
            &dir.join("scene.json"),
            json!({ "scale": 1.0, "center": [0.0, 0.0, 0.0], "near": 0.1, "far": 9.0 }).to_string(),
        );
        let mut metadata = serde_json::Map::new();
        for camera in 0..self.cameras {
            for frame in 0..self.frames {
                let entry = json!({ "warp_id": frame, "appearance_id": frame, "camera_id": camera });
                metadata.insert(id(camera, frame), entry);
                let text = self.nerfies_camera(camera, reduction).to_string();
                write(&dir.join(format!("camera/{}.json", id(camera, frame))), text);
            }
        }
        write(&dir.join("metadata.json"), Value::Object(metadata).to_string());
        self.write_frames(|camera, frame| dir.join(format!("rgb/{reduction}x/{}.png", id(camera, frame))));
    }

    fn nerfies_camera(&self, camera: usize, reduction: u32) -> Value {
        let view = self.camera(camera);
        let scale = f64::from(reduction);
        json!({
            "orientation": view.rotation.transpose().to_cols_array_2d(), "position": view.position().to_array(),
            "focal_length": scale * view.focal, "principal_point": (scale * view.center).to_array(),
            "skew": 0.0, "pixel_aspect_ratio": 1.0, "radial_distortion": [0.0, 0.0, 0.0],
            "tangential_distortion": [0.0, 0.0], "image_size": [self.size.0 * reduction, self.size.1 * reduction],
        })
    }

    /// D-NeRF: `transforms_{train,val,test}.json` and `SPLIT/r_NNN.png`; the cameras take turns.
    pub fn dnerf(&self, dir: &Path) {
        let angle = 2.0 * (f64::from(self.size.0) / (2.0 * self.camera(0).focal)).atan();
        for split in ["train", "val", "test"] {
            let frame = |index: usize| {
                let view = self.camera(index % self.cameras);
                let axes = view.rotation.transpose();
                let (x, y, z, at) = (axes.x_axis, -axes.y_axis, -axes.z_axis, view.position());
                let row = |axis: usize| [x[axis], y[axis], z[axis], at[axis]];
                let time = index as f64 / (self.frames - 1).max(1) as f64;
                let path = dir.join(format!("{split}/r_{index:03}.png"));
                super::make_folder_of(&path);
                self.image(index % self.cameras, index).save(path).expect("the temporary folder can be written");
                json!({
                    "file_path": format!("./{split}/r_{index:03}"), "time": time,
                    "transform_matrix": [row(0), row(1), row(2), [0.0, 0.0, 0.0, 1.0]],
                })
            };
            let frames: Vec<Value> = (0..self.frames).map(frame).collect();
            let file = json!({ "camera_angle_x": angle, "frames": frames });
            write(&dir.join(format!("transforms_{split}.json")), file.to_string());
        }
    }
}

/// The axis of a rotation, times its angle in radians.
fn rotation_vector(rotation: DMat3) -> DVec3 {
    glam::DQuat::from_mat3(&rotation).to_scaled_axis()
}
