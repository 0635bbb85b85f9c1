//! Slices of the images at several times of the beat with the surfaces of tracked and simulated hearts on them, \[Billet2009\] fig. 3.

use nalgebra::{Matrix4, Vector3};

use super::clock::Clock;
use super::error::RunError;
use super::patient::{Patient, PatientImages};
use super::slice_panels::{Line, in_slice, panel, section, window_around};
use crate::heart::FrameState;
use crate::image::{CineSequence, Grid, Volume};
use crate::mesh::SurfaceTag;
use crate::report::figures::{Contour, Montage, slice_montage};
use crate::study::Plan;
use crate::tracking;
use crate::units::MS_PER_S;

/// A motion with its name, for the montage.
pub(super) struct NamedMotion<'a> {
    pub(super) name: &'static str,
    pub(super) frames: &'a [FrameState],
}

/// Images with the motions that are drawn on them.
pub(super) struct ImageScene<'a> {
    pub(super) plan: &'a Plan,
    pub(super) patient: &'a Patient,
    pub(super) images: &'a PatientImages,
    pub(super) clock: &'a Clock,
    pub(super) motions: &'a [NamedMotion<'a>],
}

/// A row of a montage: one slice of one view.
struct Row<'a> {
    view: &'a CineSequence,
    slice: usize,
    title: String,
}

/// Slices of the short axis and of every further view at several times of the beat, with the surfaces of each motion on them, and the
/// cavity's outline where labels of that frame judge the result. Without further views the long axis is cut out of the short-axis stack.
pub(super) fn montages(scene: &ImageScene) -> Result<(), RunError> {
    let times = time_choice(scene.clock, scene.images, scene.motions, scene.plan.output.montage_times);
    let draw = |rows: &[Row], file: &str, title: &str| -> Result<(), RunError> {
        Ok(slice_montage(&scene.plan.output.directory.join(file), &montage(scene, rows, &times, title))?)
    };
    draw(&short_axis_rows(scene), "slices.png", "Short axis through the beat")?;
    for (number, view) in scene.images.long_axis.iter().enumerate() {
        let file = if number == 0 { "long_axis.png".to_string() } else { format!("long_axis_{}.png", number + 1) };
        draw(&long_axis_rows(scene, view, scene.plan.output.montage_slices), &file, "Long axis through the beat")?;
    }
    if scene.images.long_axis.is_empty() {
        let planes = long_axis_planes(scene)?;
        draw(&plane_rows(&planes), "long_axis.png", "Long axis through the beat, cut out of the short-axis stack")?;
    }
    Ok(())
}

/// The same slices at the frames `places`: short axis, then long axis, the middle slice of every further view.
pub(super) fn every_frame(scene: &ImageScene, places: &[usize]) -> Result<Montage, RunError> {
    let named = |axis: &'static str| move |row: Row<'_>| format!("{axis} {}", row.title);
    let short = short_axis_rows(scene).into_iter().map(|row| {
        let title = format!("Short axis {}, {}", level(scene.patient, row.view, row.slice), row.title);
        (row.view, row.slice, title)
    });
    let planes = if scene.images.long_axis.is_empty() { long_axis_planes(scene)? } else { Vec::new() };
    let views = scene.images.long_axis.iter().flat_map(|view| long_axis_rows(scene, view, 1));
    let cut = "Long axis (from the short-axis stack),";
    let long = views.map(|row| (row.view, row.slice, named("Long axis, slice at")(row)));
    let long = long.chain(plane_rows(&planes).into_iter().map(|row| (row.view, row.slice, named(cut)(row))));
    let rows: Vec<Row> = short.chain(long).map(|(view, slice, title)| Row { view, slice, title }).collect();
    Ok(montage(scene, &rows, places, "Through the beat"))
}

/// Which third of the left cavity a slice of the short axis cuts.
fn level(patient: &Patient, view: &CineSequence, slice: usize) -> &'static str {
    let axes = &patient.anatomy.axes;
    let vertices_mm = patient.anatomy.mesh.vertices_mm();
    let cavity = &patient.anatomy.cavities[0].1;
    let heights = cavity.endocardium().iter().flatten().map(|&vertex| vertices_mm[vertex].dot(&axes.long_axis));
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), height| (low.min(height), high.max(height)));
    let middle = view.grid().to_voxel(&axes.base_centre_mm);
    let height = view.grid().to_world_mm(&Vector3::new(middle.x, middle.y, slice as f64)).dot(&axes.long_axis);
    match (height - low) / (high - low).max(f64::MIN_POSITIVE) {
        ..0.34 => "near the apex",
        0.67.. => "near the base",
        _ => "at mid-ventricle",
    }
}

fn long_axis_rows<'a>(scene: &ImageScene, view: &'a CineSequence, count: usize) -> Vec<Row<'a>> {
    let place_mm = |slice: usize| format!("{:.0} mm", slice as f64 * view.grid().spacing_mm().z);
    slice_choice(scene.patient, view, count).into_iter().map(|slice| Row { view, slice, title: place_mm(slice) }).collect()
}

/// Two planes through the long axis, cut out of the short-axis stack, with what lies where.
fn long_axis_planes(scene: &ImageScene) -> Result<Vec<(CineSequence, &'static str)>, RunError> {
    let axes = &scene.patient.anatomy.axes;
    let across = axes.long_axis.cross(&axes.septal_direction);
    let through_septum = long_axis_plane(scene.patient, &scene.images.cine, &-axes.septal_direction)?;
    let beside_septum = long_axis_plane(scene.patient, &scene.images.cine, &across)?;
    Ok(vec![(through_septum, "septum on the left"), (beside_septum, "inferior wall on the left")])
}

fn plane_rows<'a>(planes: &'a [(CineSequence, &'static str)]) -> Vec<Row<'a>> {
    planes.iter().map(|(view, title)| Row { view, slice: 0, title: (*title).into() }).collect()
}

/// One row a slice of the short axis as acquired, in which the resampled images are sharpest.
fn short_axis_rows<'a>(scene: &ImageScene<'a>) -> Vec<Row<'a>> {
    let view = &scene.images.cine;
    let step_mm = view.grid().spacing_mm().z;
    let acquired = scene.images.slice_distance_mm / step_mm;
    let row = |chosen: usize| {
        let slice = ((chosen as f64 / acquired).round() * acquired).round() as usize;
        let slice = slice.min(view.grid().shape()[2] - 1);
        Row { view, slice, title: format!("{:.0} mm", slice as f64 * step_mm) }
    };
    slice_choice(scene.patient, view, scene.plan.output.montage_slices).into_iter().map(row).collect()
}

/// The cine on the plane through the long axis that also holds `rightward`, apex down, voxels of 1 mm; black where no slice reaches.
fn long_axis_plane(patient: &Patient, cine: &CineSequence, rightward: &Vector3<f64>) -> Result<CineSequence, RunError> {
    const MARGIN_MM: f64 = 25.0;
    let axes = &patient.anatomy.axes;
    let (right, down) = (rightward.normalize(), -axes.long_axis);
    let reach = |direction: &Vector3<f64>| {
        let places = patient.anatomy.mesh.vertices_mm().iter().map(|vertex| (vertex - axes.base_centre_mm).dot(direction));
        let (low, high) = places.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        (low - MARGIN_MM, high + MARGIN_MM)
    };
    let ((left, right_end), (top, bottom)) = (reach(&right), reach(&down));
    let corner_mm = axes.base_centre_mm + right * left + down * top;
    let mut to_world = Matrix4::identity();
    for (column, axis) in [right, down, right.cross(&down), corner_mm].iter().enumerate() {
        to_world.fixed_view_mut::<3, 1>(0, column).copy_from(axis);
    }
    let grid = Grid::new([(right_end - left) as usize + 1, (bottom - top) as usize + 1, 1], to_world)?;
    let places_mm: Vec<_> = (0..grid.voxel_count()).map(|flat| grid.to_world_mm(&grid.voxel_of(flat).map(|n| n as f64).into())).collect();
    let cut = |frame: &Volume| {
        let values = places_mm.iter().map(|place| frame.sample(place).unwrap_or(0.0) as f32).collect();
        Volume::new(grid.clone(), values)
    };
    let frames = cine.frames().iter().map(cut).collect::<Result<_, _>>()?;
    Ok(CineSequence::new(frames, cine.times_s().to_vec(), cine.period_s())?)
}

/// Rows of slices at the frames `times`, with the endocardia and epicardium of each motion on them.
fn montage(scene: &ImageScene, rows: &[Row], times: &[usize], title: &str) -> Montage {
    let &ImageScene { patient, images, clock, motions, .. } = scene;
    let tags = [SurfaceTag::EndocardiumLv, SurfaceTag::EndocardiumRv, SurfaceTag::Epicardium];
    let mut panels = Vec::with_capacity(rows.len() * times.len());
    let mut surfaces: Vec<String> = motions.iter().map(|motion| motion.name.to_owned()).collect();
    for Row { view, slice, .. } in rows {
        let window = window_around(&patient.anatomy, view.grid());
        for &place in times {
            let mut panel = panel(view, nearest_frame(view, clock.times_s[place]), *slice, window);
            for (surface, motion) in motions.iter().enumerate() {
                let Some(state) = motion.frames.get(place) else { continue };
                for tag in tags {
                    let triangles: Vec<_> = patient.anatomy.surface.triangles_with(tag).collect();
                    let lines = section(&triangles, &state.position_mm, view.grid(), *slice);
                    panel.contours.extend(lines.into_iter().map(|points_mm| Contour { surface, points_mm }));
                }
            }
            let labelled = label_contours(images, view, *slice, clock.frames[place]);
            if !labelled.is_empty() && surfaces.len() == motions.len() {
                surfaces.push("labels".into());
            }
            panel.contours.extend(labelled.into_iter().map(|points_mm| Contour { surface: motions.len(), points_mm }));
            panels.push(panel);
        }
    }
    Montage {
        title: title.to_owned(),
        surfaces,
        column_titles: times.iter().map(|&place| format!("{:.0} ms", clock.times_s[place] * MS_PER_S)).collect(),
        row_titles: rows.iter().map(|row| row.title.clone()).collect(),
        panels,
        window: (0.0, 255.0),
    }
}

/// The outline of the labelled cavity in a slice of the short axis, where labels of the frame judge the result.
fn label_contours(images: &PatientImages, view: &CineSequence, slice: usize, frame: usize) -> Vec<Line> {
    let of_frame = |(labelled, labels, code): &(usize, crate::image::LabelMap, u8)| {
        let on_view = labels.grid().to_voxel(&view.grid().to_world_mm(&Vector3::new(0.0, 0.0, slice as f64))).z;
        let plane = on_view.round();
        let apart_mm = (on_view - plane).abs() * labels.grid().spacing_mm().z;
        let is_shown = *labelled == frame && plane >= 0.0 && apart_mm <= view.grid().spacing_mm().z;
        let is_shown = is_shown && std::ptr::eq(view, &images.cine) && (plane as usize) < labels.grid().shape()[2];
        let contour = is_shown.then(|| tracking::Contour::of_label(labels, *code, plane as usize))?;
        Some(contour.segments_mm().iter().map(|ends| in_slice(view.grid(), ends)).collect::<Vec<_>>())
    };
    images.validation.iter().filter_map(of_frame).flatten().collect()
}

/// Slices evenly spread over the cavity, apex side first.
fn slice_choice(patient: &Patient, view: &CineSequence, count: usize) -> Vec<usize> {
    let grid = view.grid();
    let cavity = &patient.anatomy.cavities[0].1;
    let heights = cavity.endocardium().iter().flatten().map(|&v| grid.to_voxel(&patient.anatomy.mesh.vertices_mm()[v]).z);
    let (low, high) = heights.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), z| (low.min(z), high.max(z)));
    let last = grid.shape()[2].saturating_sub(1) as f64;
    let at = |n: usize| low + (high - low) * (n as f64 + 0.75) / (count as f64 + 0.5);
    (0..count).map(|n| at(n).round().clamp(0.0, last) as usize).collect()
}

/// Places in the clock, evenly spread, the start first and end-systole among them: the one frame whose labels judge the result, or the
/// smallest volume.
fn time_choice(clock: &Clock, images: &PatientImages, motions: &[NamedMotion], count: usize) -> Vec<usize> {
    let last = clock.times_s.len().saturating_sub(1);
    let mut places: Vec<usize> = (0..count).map(|n| (n * last) / count.max(1)).collect();
    let volumes = motions.first().map(|motion| motion.frames);
    let smallest = || {
        let frames = volumes?;
        let volume = |place: &usize| frames[*place].volume_ml.first().copied().unwrap_or(f64::INFINITY);
        (0..frames.len()).min_by(|a, b| volume(a).total_cmp(&volume(b)))
    };
    let judged = match images.validation.as_slice() {
        [(frame, ..)] => clock.position_of(*frame),
        _ => None,
    };
    if let Some(wanted) = judged.or_else(smallest)
        && let Some(nearest) = (1..places.len()).min_by_key(|&n| places[n].abs_diff(wanted))
    {
        places[nearest] = wanted;
    }
    places.sort_unstable();
    places.dedup();
    places
}

/// The frame nearest to a time.
fn nearest_frame(view: &CineSequence, time_s: f64) -> usize {
    let (earlier, later, weight) = view.frames_around(time_s);
    if weight < 0.5 { earlier } else { later }
}
