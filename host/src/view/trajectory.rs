//! Trajectories in the TUM format: one line `time tx ty tz qx qy qz qw` per pose.

use std::io::{Error, ErrorKind, Result};
use std::path::Path;

use crate::log::write::write_atomically;
use crate::space::Pose;

/// Writes object-to-world poses at `times` in seconds: metres and a unit quaternion, as the common
/// trajectory tools read it. Fails without touching `path` if there is not one time per pose.
pub fn write_tum(path: &Path, times: &[f64], poses: &[Pose]) -> Result<()> {
    if times.len() != poses.len() {
        let message = format!("{} times for {} poses: expected as many", times.len(), poses.len());
        return Err(Error::new(ErrorKind::InvalidInput, message));
    }
    write_atomically(path, |out| {
        writeln!(out, "# time tx ty tz qx qy qz qw")?;
        for (time, pose) in times.iter().zip(poses) {
            let t = pose.translation.vector;
            let q = pose.rotation.quaternion();
            // Of the two quaternions of a rotation the one with w ≥ 0.
            let q = if q.w < 0.0 { -*q } else { *q };
            writeln!(
                out,
                "{time:.6} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9} {:.9}",
                t.x, t.y, t.z, q.i, q.j, q.k, q.w
            )?;
        }
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::space::planar;

    #[test]
    fn poses_are_one_line_each() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectory.tum");
        let poses = [planar(0.1, -0.2, 0.0), planar(0.0, 0.0, std::f64::consts::FRAC_PI_2)];
        write_tum(&path, &[0.0, 1.5], &poses).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        assert_eq!(
            text,
            "# time tx ty tz qx qy qz qw\n\
             0.000000 0.100000000 -0.200000000 0.000000000 0.000000000 0.000000000 0.000000000 1.000000000\n\
             1.500000 0.000000000 0.000000000 0.000000000 0.000000000 0.000000000 0.707106781 0.707106781\n"
        );
    }

    #[test]
    fn a_missing_time_leaves_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trajectory.tum");
        assert!(write_tum(&path, &[], &[planar(0.0, 0.0, 0.0)]).is_err());
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
}
