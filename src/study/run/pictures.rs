//! The figures of a run: what was computed, put into the forms that the figure writers take.

use crate::anatomy::Ventricle;
use crate::circulation::Phase;
use crate::heart::Trajectory;
use crate::image::CineSequence;
use crate::mesh::SurfaceTag;
use crate::report::figures::{
    Contour, Curve, Look, LoopPoint, Montage, MontagePanel, PressureCurves, PressureVolumeLoop, TimeBand, VolumeCurves,
    pressure_volume_loop, pressures, slice_montage, volume_curves,
};
use crate::study::Plan;
use crate::tracking;
use crate::units::MS_PER_S;

use super::clock::Clock;
use super::error::RunError;
use super::patient::{Patient, PatientImages};

/// Volumes over the last beat, pressure–volume loop and pressures; `further` curves join the volumes.
pub(super) fn beat(plan: &Plan, clock: &Clock, trajectory: &Trajectory, further: &[Curve]) -> Result<(), RunError> {
    let folder = &plan.output.directory;
    for (ventricle, suffix, name, artery) in [(Ventricle::Left, "lv", "LV", "aorta"), (Ventricle::Right, "rv", "RV", "pulmonary artery")] {
        let rows: Vec<_> = last_beat(clock, trajectory).filter_map(|row| Some((row.time_s, row.ventricle(ventricle)?))).collect();
        if rows.is_empty() {
            continue;
        }
        let times_s: Vec<f64> = rows.iter().map(|(time_s, _)| *time_s).collect();
        let of = |value: fn(&crate::heart::VentricleCurve) -> f64| rows.iter().map(|(_, curve)| value(curve)).collect::<Vec<f64>>();
        let (volume_ml, pressure_kpa) = (of(|c| c.volume_ml), of(|c| c.pressure_kpa));
        let mut curves = vec![Curve::new("model", Look::Simulated, &times_s, &volume_ml)];
        if ventricle == Ventricle::Left {
            curves.extend(further.iter().cloned());
        }
        let title = format!("{name} volume over the beat");
        volume_curves(&folder.join(format!("volume_{suffix}.png")), &VolumeCurves { title, quantity: format!("{name} volume"), curves })?;
        let title = format!("Pressure–volume loop, {name}");
        let loops = vec![Curve::new("model", Look::Simulated, &volume_ml, &pressure_kpa)];
        let figure = PressureVolumeLoop { title, ventricle: name.into(), loops, points: corners(&rows) };
        pressure_volume_loop(&folder.join(format!("pressure_volume_{suffix}.png")), &figure)?;
        let curves = vec![
            Curve::new(format!("{name} cavity"), Look::Simulated, &times_s, &pressure_kpa),
            Curve::new(artery, Look::Artery, &times_s, &of(|c| c.arterial_pressure_kpa)),
            Curve::new("atrium", Look::Other, &times_s, &of(|c| c.atrial_pressure_kpa)),
        ];
        let phases = bands(&rows);
        pressures(
            &folder.join(format!("pressures_{suffix}.png")),
            &PressureCurves { title: format!("Pressures, {name}"), curves, phases },
        )?;
    }
    Ok(())
}

/// Rows of the last beat, the one it starts from included.
fn last_beat<'a>(clock: &Clock, trajectory: &'a Trajectory) -> impl Iterator<Item = &'a crate::heart::CurveRow> {
    let from_s = clock.last_beat_s() - 1e-9;
    trajectory.curves.iter().filter(move |row| row.time_s >= from_s)
}

fn phase_name(phase: Phase) -> &'static str {
    match phase {
        Phase::Filling => "filling",
        Phase::IsovolumetricContraction => "IVC",
        Phase::Ejection => "ejection",
        Phase::IsovolumetricRelaxation => "IVR",
    }
}

/// Runs of one phase. A row's phase is that of the step that led to it.
fn bands(rows: &[(f64, crate::heart::VentricleCurve)]) -> Vec<TimeBand> {
    let mut bands: Vec<TimeBand> = Vec::new();
    for pair in rows.windows(2) {
        let (from_s, (to_s, curve)) = (pair[0].0, pair[1]);
        let name = phase_name(curve.phase);
        match bands.last_mut() {
            Some(band) if band.name == name => band.to_s = to_s,
            _ => bands.push(TimeBand { name: name.into(), from_s, to_s }),
        }
    }
    bands
}

/// Where the valves open and close.
fn corners(rows: &[(f64, crate::heart::VentricleCurve)]) -> Vec<LoopPoint> {
    let named = |phase: Phase| match phase {
        Phase::IsovolumetricContraction => Some("mitral valve closes"),
        Phase::Ejection => Some("aortic valve opens"),
        Phase::IsovolumetricRelaxation => Some("aortic valve closes"),
        Phase::Filling => Some("mitral valve opens"),
    };
    let changes = rows.windows(2).filter(|pair| pair[0].1.phase != pair[1].1.phase);
    let mut points: Vec<LoopPoint> = Vec::new();
    for pair in changes {
        let (before, after) = (pair[0].1, pair[1].1);
        if let Some(name) = named(after.phase).filter(|name| points.iter().all(|point| point.name != *name)) {
            points.push(LoopPoint { name: name.into(), volume_ml: before.volume_ml, pressure_kpa: before.pressure_kpa });
        }
    }
    points
}

/// A motion with its name, for the montage.
pub(super) struct NamedMotion<'a> {
    pub(super) name: &'static str,
    pub(super) trajectory: &'a Trajectory,
}

/// Slices at several times of the beat, with the endocardium and epicardium of each motion on them.
pub(super) fn montage(
    plan: &Plan,
    patient: &Patient,
    images: &PatientImages,
    clock: &Clock,
    motions: &[NamedMotion],
    file: &str,
    title: String,
) -> Result<(), RunError> {
    let slices = slice_choice(patient, images, plan.output.montage_slices);
    let times = time_choice(clock, motions, plan.output.montage_times);
    let tags = [SurfaceTag::EndocardiumLv, SurfaceTag::EndocardiumRv, SurfaceTag::Epicardium];
    let window = window_around(patient, images);
    let mut panels = Vec::with_capacity(slices.len() * times.len());
    for &k in &slices {
        for &place in &times {
            let mut panel = panel(&images.cine, clock.frames[place], k, window);
            for (surface, motion) in motions.iter().enumerate() {
                let Some(state) = motion.trajectory.frames.get(place) else { continue };
                for tag in tags {
                    let triangles: Vec<_> = patient.anatomy.surface.triangles_with(tag).collect();
                    let cut = tracking::Contour::of_surface(&triangles, &state.position_mm, images.cine.grid(), k);
                    panel
                        .contours
                        .extend(cut.segments_mm().iter().map(|ends| Contour { surface, points_mm: in_slice(&images.cine, ends) }));
                }
            }
            panels.push(panel);
        }
    }
    let step_mm = images.cine.grid().spacing_mm().z;
    let figure = Montage {
        title,
        surfaces: motions.iter().map(|motion| motion.name.to_owned()).collect(),
        column_titles: times.iter().map(|&place| format!("{:.0} ms", clock.times_s[place] * MS_PER_S)).collect(),
        row_titles: slices.iter().map(|&k| format!("{:.0} mm", k as f64 * step_mm)).collect(),
        panels,
        window: (0.0, 255.0),
    };
    Ok(slice_montage(&plan.output.directory.join(file), &figure)?)
}

/// Slices evenly spread over the cavity, apex side first.
fn slice_choice(patient: &Patient, images: &PatientImages, count: usize) -> Vec<usize> {
    let grid = images.cine.grid();
    let cavity = &patient.anatomy.cavities[0].1;
    let heights = cavity.endocardium().iter().flatten().map(|&v| grid.to_voxel(&patient.anatomy.mesh.vertices_mm()[v]).z);
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
    let last = grid.shape()[2].saturating_sub(1) as f64;
    let at = |n: usize| low + (high - low) * (n as f64 + 0.75) / (count as f64 + 0.5);
    (0..count).map(|n| at(n).round().clamp(0.0, last) as usize).collect()
}

/// Places in the clock, evenly spread, the start first and the smallest volume among them.
fn time_choice(clock: &Clock, motions: &[NamedMotion], count: usize) -> Vec<usize> {
    let last = clock.times_s.len().saturating_sub(1);
    let mut places: Vec<usize> = (0..count).map(|n| (n * last) / count.max(1)).collect();
    let volumes = motions.first().map(|motion| &motion.trajectory.frames);
    let smallest = volumes.and_then(|frames| {
        let volume = |place: &usize| frames[*place].volume_ml.first().copied().unwrap_or(f64::INFINITY);
        (0..frames.len()).min_by(|a, b| volume(a).total_cmp(&volume(b)))
    });
    if let Some(smallest) = smallest
        && let Some(nearest) = (1..places.len()).min_by_key(|&n| places[n].abs_diff(smallest))
    {
        places[nearest] = smallest;
    }
    places.sort_unstable();
    places.dedup();
    places
}

/// The voxels shown: first and last along i and j.
type Window = [[usize; 2]; 2];

/// The heart with 20 mm around it.
fn window_around(patient: &Patient, images: &PatientImages) -> Window {
    const MARGIN_MM: f64 = 20.0;
    let grid = images.cine.grid();
    let mut window = [[0; 2]; 2];
    for (axis, bounds) in window.iter_mut().enumerate() {
        let places = patient.anatomy.mesh.vertices_mm().iter().map(|v| grid.to_voxel(v)[axis]);
        let (low, high) = places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        let margin = MARGIN_MM / grid.spacing_mm()[axis];
        let last = grid.shape()[axis].saturating_sub(1) as f64;
        *bounds = [(low - margin).floor().clamp(0.0, last) as usize, (high + margin).ceil().clamp(0.0, last) as usize];
    }
    window
}

fn panel(cine: &CineSequence, frame: usize, k: usize, [[i0, i1], [j0, j1]]: Window) -> MontagePanel {
    let spacing = cine.grid().spacing_mm();
    let frame = &cine.frames()[frame];
    let intensity = (j0..=j1).flat_map(|j| (i0..=i1).map(move |i| f64::from(frame.at([i, j, k])))).collect();
    MontagePanel {
        columns: i1 - i0 + 1,
        rows: j1 - j0 + 1,
        intensity,
        origin_mm: [i0 as f64 * spacing.x, j0 as f64 * spacing.y],
        spacing_mm: [spacing.x, spacing.y],
        contours: Vec::new(),
    }
}

fn in_slice(cine: &CineSequence, ends: &[nalgebra::Vector3<f64>]) -> Vec<[f64; 2]> {
    let spacing = cine.grid().spacing_mm();
    let at = |end| {
        let voxel = cine.grid().to_voxel(end);
        [voxel.x * spacing.x, voxel.y * spacing.y]
    };
    ends.iter().map(at).collect()
}
