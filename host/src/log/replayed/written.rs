//! What a recording tells, as JSON and as a table.

use std::io::{self, Write};

use serde_json::{Value, json};

use super::{RecordedEstimate, Replayed};
use crate::space::{self, Pose};

impl RecordedEstimate {
    /// As a log has it in the field `estimate`.
    pub(super) fn to_json(&self, dimension: usize) -> Value {
        let pose = |pose: &Pose| {
            let t = pose.translation.vector;
            let q = pose.rotation.coords;
            match dimension {
                2 => json!({ "translation": [t.x, t.y], "rotation": space::angle(pose) }),
                _ => json!({ "translation": [t.x, t.y, t.z], "rotation": [q.x, q.y, q.z, q.w] }),
            }
        };
        let modes = self.modes.iter().map(|(p, weight)| {
            let mut mode = pose(p);
            mode["weight"] = json!(weight);
            mode
        });
        json!({
            "pose": pose(&self.pose), "modes": modes.collect::<Vec<_>>(),
            "deviations": self.deviations, "effective_particles": self.effective_particles,
            "corrected": self.corrected, "status": self.status.name(),
        })
    }
}

impl Replayed {
    /// Writes one line per estimate: grasp, time (s), position (m), rotation (radians or quaternion
    /// x, y, z, w), standard deviations in object axes (m, rad), counts.
    ///
    /// # Errors
    /// When the writer fails.
    pub fn write_csv(&self, writer: &mut (impl Write + ?Sized)) -> io::Result<()> {
        let counts = "effective_particles,contacts,rejected,dropped,corrected,resampled,status";
        let planar = self.log.dimension == 2;
        if planar {
            writeln!(writer, "grasp,time,x,y,angle,sd_x,sd_y,sd_angle,{counts}")?;
        } else {
            let sd = "sd_x,sd_y,sd_z,sd_rx,sd_ry,sd_rz";
            writeln!(writer, "grasp,time,x,y,z,qx,qy,qz,qw,{sd},{counts}")?;
        }
        for e in &self.estimates {
            let t = e.pose.translation.vector;
            let q = e.pose.rotation.coords;
            write!(writer, "{},{:.6},", e.grasp, e.time.as_secs_f64())?;
            if planar {
                write!(writer, "{:.6},{:.6},{:.6}", t.x, t.y, space::angle(&e.pose))?;
            } else {
                write!(writer, "{:.6},{:.6},{:.6},", t.x, t.y, t.z)?;
                write!(writer, "{:.6},{:.6},{:.6},{:.6}", q.x, q.y, q.z, q.w)?;
            }
            for deviation in &e.deviations {
                write!(writer, ",{deviation:.6}")?;
            }
            let [contacts, rejected, dropped] = e.contacts;
            write!(writer, ",{},{contacts},{rejected},{dropped}", e.effective_particles)?;
            let (corrected, resampled) = (u8::from(e.corrected), u8::from(e.resampled));
            writeln!(writer, ",{corrected},{resampled},{}", e.status.name())?;
        }
        Ok(())
    }
}
