//! The motion of the base that an earlier run left, as an input of this one, \[Billet2009\] §5.

use std::path::Path;
use std::sync::Arc;

use nalgebra::Vector3;

use super::error::RunError;
use crate::anatomy::Anatomy;
use crate::heart::{BaseMotion, HeartModel, ModelSettings, Parameter};
use crate::mesh::SurfaceTag;
use crate::study::Plan;

/// The heart with its base springs anchored on the recorded motion, where the plan names one.
pub(super) fn with_recorded_base(plan: &Plan, model: HeartModel) -> Result<HeartModel, RunError> {
    let Some(file) = &plan.tracking.base_motion else { return Ok(model) };
    let motion = read_base_motion(file, model.anatomy(), model.parameters()[Parameter::HeartPeriod])?;
    let settings = ModelSettings { base_motion: Some(motion), ..model.settings().clone() };
    Ok(HeartModel::new(Arc::clone(model.anatomy()), model.parameters().clone(), settings)?)
}

/// Reads a `base_motion.csv` (`frame,time_s,vertex,x_mm,y_mm,z_mm`, by time, then by vertex) of one cycle.
///
/// # Errors
/// [`RunError::BaseMotion`] if the file is not one, or belongs to another mesh.
pub(super) fn read_base_motion(file: &Path, anatomy: &Anatomy, period_s: f64) -> Result<Arc<BaseMotion>, RunError> {
    let refuse = |reason: String| RunError::BaseMotion { file: file.into(), reason };
    let text = std::fs::read_to_string(file).map_err(|error| refuse(error.to_string()))?;
    let vertices = anatomy.surface.vertices_with(SurfaceTag::Base);
    if vertices.is_empty() {
        return Err(refuse("this mesh has no base".into()));
    }
    let mut lines = text.lines();
    if lines.next() != Some("frame,time_s,vertex,x_mm,y_mm,z_mm") {
        return Err(refuse("its first line is not `frame,time_s,vertex,x_mm,y_mm,z_mm`".into()));
    }
    let (mut times_s, mut positions_mm): (Vec<f64>, Vec<Vec<Vector3<f64>>>) = (Vec::new(), Vec::new());
    for (number, line) in lines.enumerate() {
        let cells: Vec<f64> = line.split(',').filter_map(|cell| cell.parse().ok()).collect();
        let &[_, time_s, vertex, x, y, z] = &cells[..] else { return Err(refuse(format!("line {} has no six numbers", number + 2))) };
        if vertices[number % vertices.len()] as f64 != vertex {
            return Err(refuse(format!(
                "line {} has vertex {vertex} where this mesh has base vertex {}; it must come from a run with the same mesh",
                number + 2,
                vertices[number % vertices.len()]
            )));
        }
        if number % vertices.len() == 0 {
            times_s.push(time_s);
            positions_mm.push(Vec::with_capacity(vertices.len()));
        }
        if let Some(instant) = positions_mm.last_mut() {
            instant.push(Vector3::new(x, y, z));
        }
    }
    // A run ends where it started, one period on.
    let within = times_s.iter().filter(|&&time_s| time_s < times_s[0] + period_s - 1e-6).count();
    times_s.truncate(within);
    positions_mm.truncate(within);
    Ok(Arc::new(BaseMotion::new(times_s, positions_mm, period_s)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::AnatomySettings;
    use crate::anatomy::mesher::MesherSettings;
    use crate::phantom::IdealisedLv;

    fn anatomy() -> Anatomy {
        IdealisedLv::default().build(&MesherSettings::with_edge_length_mm(14.0), &AnatomySettings::default()).unwrap()
    }

    /// What a run of four frames writes whose base is lifted by `lift_mm(frame)`, the first frame again last.
    fn written(anatomy: &Anatomy, lift_mm: impl Fn(usize) -> f64) -> String {
        let mut text = String::from("frame,time_s,vertex,x_mm,y_mm,z_mm\n");
        for n in 0..=4 {
            for vertex in anatomy.surface.vertices_with(SurfaceTag::Base) {
                let at = anatomy.mesh.vertices_mm()[vertex];
                text += &format!("{},{},{vertex},{},{},{}\n", n % 4, 0.2 * n as f64 - 0.1, at.x, at.y, at.z + lift_mm(n % 4));
            }
        }
        text
    }

    fn read(text: &str, anatomy: &Anatomy) -> Result<Arc<BaseMotion>, RunError> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), text).unwrap();
        read_base_motion(file.path(), anatomy, 0.8)
    }

    #[test]
    fn what_a_run_writes_comes_back_and_repeats() {
        let anatomy = anatomy();
        let motion = read(&written(&anatomy, |n| -2.0 * n as f64), &anatomy).unwrap();
        let vertices = anatomy.surface.vertices_with(SurfaceTag::Base);
        let mut positions_mm = Vec::new();
        for (time_s, lift_mm) in [(-0.1, 0.0), (0.1, -2.0), (0.4, -5.0), (1.3, -6.0)] {
            motion.position_mm(time_s, &mut positions_mm);
            for (position, &vertex) in positions_mm.iter().zip(&vertices) {
                assert!((position.z - anatomy.mesh.vertices_mm()[vertex].z - lift_mm).abs() < 1e-9, "{time_s} s");
            }
        }
    }

    #[test]
    fn a_motion_of_another_mesh_or_no_motion_is_refused_with_its_line() {
        let anatomy = anatomy();
        let text = written(&anatomy, |_| 0.0);
        let other = text.replacen(&format!(",{},", anatomy.surface.vertices_with(SurfaceTag::Base)[0]), ",99999,", 1);
        let cut = &text[..text.len() * 7 / 10];
        for (bad, word) in [("x,y\n", "first line"), (other.as_str(), "line 2 has vertex 99999"), (cut, "")] {
            let error = read(bad, &anatomy).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}
