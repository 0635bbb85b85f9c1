//! The figures of a run: what was computed, put into the forms that the figure writers take.

use std::path::Path;

use crate::anatomy::{Anatomy, Ventricle};
use crate::circulation::Phase;
use crate::heart::{BeatDeformation, HeartModel, Strain, Trajectory, phase_events};
use crate::report::figures::{
    BeatCurves, Curve, Look, LoopPoint, PressureVolumeLoop, StrainCurves, StrainPanel, SurfaceMap, SurfaceView, TimeBand, VolumeCurves,
    beat_curves, pressure_volume_loop, strain_curves, surface_map, volume_curves,
};
use crate::study::Plan;
use crate::units::MS_PER_S;

use super::clock::Clock;
use super::error::RunError;
use super::forward::deformation;

/// The figures of one ventricle in the last beat.
pub(super) struct VentricleFigures {
    pub(super) ventricle: Ventricle,
    pub(super) volume: VolumeCurves,
    pub(super) pressure_volume: PressureVolumeLoop,
    pub(super) beat: BeatCurves,
}

/// Draws volumes over the last beat, pressure–volume loop and pressures; `further` curves join the volumes of the left ventricle.
pub(super) fn beat(plan: &Plan, clock: &Clock, trajectory: &Trajectory, further: &[Curve]) -> Result<(), RunError> {
    let folder = &plan.output.directory;
    for figures in ventricle_figures(clock, trajectory, further) {
        let suffix = if figures.ventricle == Ventricle::Left { "lv" } else { "rv" };
        volume_curves(&folder.join(format!("volume_{suffix}.png")), &figures.volume)?;
        pressure_volume_loop(&folder.join(format!("pressure_volume_{suffix}.png")), &figures.pressure_volume)?;
        beat_curves(&folder.join(format!("beat_{suffix}.png")), &figures.beat)?;
    }
    Ok(())
}

/// What there is to draw of the last beat, a ventricle each.
pub(super) fn ventricle_figures(clock: &Clock, trajectory: &Trajectory, further: &[Curve]) -> Vec<VentricleFigures> {
    let ventricles = [(Ventricle::Left, "LV", "aorta"), (Ventricle::Right, "RV", "pulmonary artery")];
    ventricles.into_iter().filter_map(|names| figures_of(clock, trajectory, further, names)).collect()
}

fn figures_of(
    clock: &Clock,
    trajectory: &Trajectory,
    further: &[Curve],
    (ventricle, name, artery): (Ventricle, &str, &str),
) -> Option<VentricleFigures> {
    let rows: Vec<_> = last_beat(clock, trajectory).filter_map(|row| Some((row.time_s, row.ventricle(ventricle)?))).collect();
    if rows.is_empty() {
        return None;
    }
    let trigger_s = clock.last_trigger_s();
    let times_s: Vec<f64> = rows.iter().map(|(time_s, _)| time_s - trigger_s).collect();
    let of = |value: fn(&crate::heart::VentricleCurve) -> f64| rows.iter().map(|(_, curve)| value(curve)).collect::<Vec<f64>>();
    let (volume_ml, pressure_kpa) = (of(|c| c.volume_ml), of(|c| c.pressure_kpa));
    let mut curves = vec![Curve::new("model", Look::Simulated, &times_s, &volume_ml)];
    if ventricle == Ventricle::Left {
        curves.extend(further.iter().map(|curve| later(curve, -trigger_s)));
    }
    let pressures = vec![
        Curve::new(format!("{name} cavity"), Look::Simulated, &times_s, &pressure_kpa),
        Curve::new(artery, Look::Artery, &times_s, &of(|c| c.arterial_pressure_kpa)),
        Curve::new("atrium", Look::Other, &times_s, &of(|c| c.atrial_pressure_kpa)),
    ];
    Some(VentricleFigures {
        ventricle,
        volume: VolumeCurves { title: format!("{name} volume over the beat"), quantity: format!("{name} volume"), curves },
        pressure_volume: PressureVolumeLoop {
            title: format!("Pressure–volume loop, {name}"),
            ventricle: name.into(),
            loops: vec![Curve::new("model", Look::Simulated, &volume_ml, &pressure_kpa)],
            points: corners(&rows, ventricle),
        },
        beat: BeatCurves {
            title: format!("The {name} over the beat"),
            pressures,
            volume: Curve::new(format!("{name} volume"), Look::Simulated, &times_s, &volume_ml),
            phases: bands(clock, trajectory, ventricle),
        },
    })
}

/// Pressures and volumes over all beats, where these are not all alike.
pub(super) fn all_beats(plan: &Plan, trajectory: &Trajectory) -> Result<(), RunError> {
    for (ventricle, suffix, name, artery) in [(Ventricle::Left, "lv", "LV", "aorta"), (Ventricle::Right, "rv", "RV", "pulmonary artery")] {
        let rows: Vec<_> = trajectory.curves.iter().filter_map(|row| Some((row.time_s, row.ventricle(ventricle)?))).collect();
        if rows.is_empty() {
            continue;
        }
        let times_s: Vec<f64> = rows.iter().map(|(time_s, _)| *time_s).collect();
        let of = |value: fn(&crate::heart::VentricleCurve) -> f64| rows.iter().map(|(_, curve)| value(curve)).collect::<Vec<f64>>();
        let figure = BeatCurves {
            title: format!("The {name} over all beats"),
            pressures: vec![
                Curve::new(format!("{name} cavity"), Look::Simulated, &times_s, &of(|c| c.pressure_kpa)),
                Curve::new(artery, Look::Artery, &times_s, &of(|c| c.arterial_pressure_kpa)),
            ],
            volume: Curve::new(format!("{name} volume"), Look::Simulated, &times_s, &of(|c| c.volume_ml)),
            phases: vec![],
        };
        beat_curves(&plan.output.directory.join(format!("all_beats_{suffix}.png")), &figure)?;
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

/// The phases of the last beat between the events of its valves.
fn bands(clock: &Clock, trajectory: &Trajectory, ventricle: Ventricle) -> Vec<TimeBand> {
    let rows: Vec<_> = last_beat(clock, trajectory).copied().collect();
    let Some(first) = rows.get(1).and_then(|row| row.ventricle(ventricle)) else { return Vec::new() };
    let events = phase_events(&rows, ventricle);
    // The phase of the first row is that of the beat before.
    let later = events.iter().filter(|event| event.time_s > rows[1].time_s).map(|event| (event.time_s, event.begins));
    let begins: Vec<(f64, Phase)> = std::iter::once((rows[0].time_s, first.phase)).chain(later).collect();
    let ends = begins.iter().skip(1).map(|(time_s, _)| *time_s).chain(rows.last().map(|row| row.time_s));
    let trigger_s = clock.last_trigger_s();
    let band = |(&(from_s, phase), to_s): (&(f64, Phase), f64)| TimeBand {
        name: phase_name(phase).into(),
        from_s: from_s - trigger_s,
        to_s: to_s - trigger_s,
    };
    begins.iter().zip(ends).map(band).collect()
}

/// A curve shifted in time.
pub(super) fn later(curve: &Curve, shift_s: f64) -> Curve {
    Curve { points: curve.points.iter().map(|&(time_s, value)| (time_s + shift_s, value)).collect(), ..curve.clone() }
}

/// Where the valves open and close.
fn corners(rows: &[(f64, crate::heart::VentricleCurve)], ventricle: Ventricle) -> Vec<LoopPoint> {
    let (inflow, outflow) = if ventricle == Ventricle::Left { ("mitral", "aortic") } else { ("tricuspid", "pulmonary") };
    let named = |phase: Phase| match phase {
        Phase::IsovolumetricContraction => format!("{inflow} valve closes"),
        Phase::Ejection => format!("{outflow} valve opens"),
        Phase::IsovolumetricRelaxation => format!("{outflow} valve closes"),
        Phase::Filling => format!("{inflow} valve opens"),
    };
    let mut points: Vec<LoopPoint> = Vec::new();
    for pair in rows.windows(2).filter(|pair| pair[0].1.phase != pair[1].1.phase) {
        let (before, name) = (pair[0].1, named(pair[1].1.phase));
        if points.iter().all(|point| point.name != name) {
            points.push(LoopPoint { name, volume_ml: before.volume_ml, pressure_kpa: before.pressure_kpa });
        }
    }
    points
}

/// What the wall does in the last beat: the activation map and the strains by segment.
pub(super) fn wall(plan: &Plan, model: &HeartModel, clock: &Clock, trajectory: &Trajectory) -> Result<(), RunError> {
    let folder = &plan.output.directory;
    activation(&folder.join("activation.png"), model, "Activation")?;
    match deformation(model, trajectory, clock) {
        Some(beat) => Ok(strain_curves(&folder.join("strains.png"), &strains(&beat, clock.last_trigger_s()))?),
        None => Ok(()),
    }
}

/// Draws the depolarisation times of a heart.
pub(super) fn activation(file: &Path, model: &HeartModel, title: &str) -> Result<(), RunError> {
    Ok(surface_map(file, &activation_map(model, title))?)
}

/// Depolarisation times on the whole boundary, seen from both sides of the plane through both ventricles, a little from above.
fn activation_map(model: &HeartModel, title: &str) -> SurfaceMap {
    const ISOCHRONES_MS: f64 = 10.0;
    let anatomy = model.anatomy();
    SurfaceMap {
        title: title.into(),
        quantity: "depolarisation time (ms)".into(),
        vertices_mm: anatomy.mesh.vertices_mm().to_vec(),
        triangles: anatomy.surface.triangles().to_vec(),
        values: model.activation().times_s().iter().map(|time_s| time_s * MS_PER_S).collect(),
        band: ISOCHRONES_MS,
        views: views(anatomy),
    }
}

/// Both sides of the plane through both ventricles, a little from above.
pub(super) fn views(anatomy: &Anatomy) -> Vec<SurfaceView> {
    let axes = &anatomy.axes;
    let across = axes.long_axis.cross(&axes.septal_direction);
    let view = |name: &str, side: nalgebra::Vector3<f64>| SurfaceView {
        name: name.into(),
        to_eye: side + axes.long_axis * 0.45,
        up: axes.long_axis,
    };
    match anatomy.cavities.len() {
        1 => vec![view("septum on the left", across), view("septum on the right", -across)],
        _ => vec![view("right ventricle on the left", across), view("right ventricle on the right", -across)],
    }
}

/// The strain curves of the segments 1–16, by wall; the apical cap belongs to none.
pub(super) fn strains(beat: &BeatDeformation, trigger_s: f64) -> StrainCurves {
    let times_s: Vec<f64> = beat.times_s.iter().map(|time_s| time_s - trigger_s).collect();
    let panel = |direction: &str, value: fn(&Strain) -> f64| {
        let curve = |(segment, (name, look)): (u8, (&str, Look))| {
            let values: Vec<f64> = beat.strains_of(segment).iter().map(value).collect();
            Curve::new(name, look, &times_s, &values)
        };
        let curves = (1..=16).map(|segment| (segment, wall_of(segment))).map(curve).filter(|curve| !curve.points.is_empty());
        StrainPanel { direction: direction.into(), curves: curves.collect() }
    };
    let panels =
        vec![panel("circumferential", |s| s.circumferential), panel("longitudinal", |s| s.longitudinal), panel("radial", |s| s.radial)];
    StrainCurves { title: "Strain of the segments against end-diastole".into(), panels }
}

/// The wall that an AHA segment belongs to.
fn wall_of(segment: u8) -> (&'static str, Look) {
    match segment {
        2 | 3 | 8 | 9 | 14 => ("septum", Look::Septum),
        1 | 7 | 13 => ("anterior", Look::Anterior),
        4 | 10 | 15 => ("inferior", Look::Inferior),
        _ => ("lateral", Look::Lateral),
    }
}
