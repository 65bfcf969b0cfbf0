//! The poses of a sequence, which a motion capture system measured at other times than those of the images.

use std::path::Path;

use engine::{Failure, FailureKind};
use glam::{DMat3, DQuat, DVec3};
use scene::RigidTransform;

use super::series::{Series, Timed};
use crate::error::Result;
use crate::matrices::rotation;

/// The file of poses.
pub(super) const POSES: &str = "groundtruth.txt";
/// The numbers of a line.
const COLUMNS: &str = "timestamp tx ty tz qx qy qz qw";
/// Largest time between two poses that are interpolated. An acceleration of 2 m/s² moves a camera by 2.5 mm from the
/// straight line in this time.
const LARGEST_GAP_SECS: f64 = 0.1;

/// A pose in the world.
#[derive(Clone, Copy)]
struct Pose {
    position: DVec3,
    rotation: DQuat,
}

/// Poses in the order of their times.
pub(super) struct Trajectory {
    poses: Series<Pose>,
}

impl Trajectory {
    /// Reads `groundtruth.txt` of the sequence in `dir`.
    pub(super) fn read(dir: &Path) -> Result<Self> {
        let path = dir.join(POSES);
        if !path.is_file() {
            let hint = format!(
                "sequences for validation have none: estimate poses with `pipeline prepare rgb --out DIR`, or write {POSES} \
                 with a line per pose, {COLUMNS} (camera to world)"
            );
            let failure =
                Failure::new(FailureKind::MissingData, format!("the sequence has no poses: {POSES} is missing"));
            return Err(failure.hint(hint).at(dir));
        }
        let poses = Series::read(&path, |line| {
            let [time_secs, x, y, z, qx, qy, qz, qw] = line.finite(COLUMNS)?;
            let rotation = rotation(DQuat::from_xyzw(qx, qy, qz, qw), line.number)?;
            let value = Pose { position: DVec3::new(x, y, z), rotation: DQuat::from_mat3(&rotation) };
            Ok(Timed { time_secs, value })
        })?;
        Ok(Self { poses })
    }

    /// The pose at a time, from camera to world: interpolated between two poses that are near each other, or else that of the
    /// same instant. `None` where the trajectory has a gap.
    pub(super) fn world_from_camera(&self, time_secs: f64) -> Option<RigidTransform> {
        let between = match self.poses.around(time_secs) {
            [Some(before), Some(after)] if after.time_secs - before.time_secs <= LARGEST_GAP_SECS => {
                let share = (time_secs - before.time_secs) / (after.time_secs - before.time_secs);
                Some(before.value.toward(after.value, share))
            }
            _ => None,
        };
        let pose = between.or_else(|| self.poses.nearest(time_secs).copied())?;
        Some(RigidTransform { rotation: DMat3::from_quat(pose.rotation), translation: pose.position })
    }

    /// The first and the last time, for errors.
    pub(super) fn span(&self) -> String {
        self.poses.span()
    }
}

impl Pose {
    /// The pose at this share, 0 to 1, of the way to another pose.
    fn toward(self, other: Self, share: f64) -> Self {
        Self {
            position: self.position.lerp(other.position, share),
            rotation: self.rotation.slerp(other.rotation, share),
        }
    }
}
