//! The heart through the beat: slices of the images with its contours, and the beating mesh with what its wall does.

use nalgebra::Vector3;

use crate::anatomy::Anatomy;
use crate::heart::{FrameState, HeartModel, Strain, Trajectory};
use crate::mesh::SurfaceTag;
use crate::report::html::{BeatingHeart, Block, Scale, Section, Slices, SurfaceField, SurfaceValues};
use crate::study::run::clock::Clock;
use crate::study::run::error::RunError;
use crate::study::run::forward::deformation;
use crate::study::run::montages::{ImageScene, every_frame};
use crate::study::run::pictures::views;
use crate::units::MS_PER_S;

/// Frames that are shown at most: more are not seen, and make the file large.
const MOST_FRAMES: usize = 31;

/// The frames of a beat that a report shows.
pub(in crate::study::run) struct Frames {
    /// Their places in the trajectory.
    pub(in crate::study::run) places: Vec<usize>,
    /// Their times after the trigger, s.
    pub(in crate::study::run) times_s: Vec<f64>,
}

impl Frames {
    /// All frames, or some that are spread evenly, first and last among them.
    pub(in crate::study::run) fn of(clock: &Clock, frames: &[FrameState]) -> Self {
        let last = frames.len().saturating_sub(1);
        let count = frames.len().min(MOST_FRAMES);
        let places: Vec<usize> = (0..count).map(|n| n * last / count.saturating_sub(1).max(1)).collect();
        let times_s = places.iter().map(|&place| frames[place].time_s - clock.last_trigger_s()).collect();
        Self { places, times_s }
    }
}

/// The motion of a heart that a mesh is coloured by; of one that no model moves, nothing but its displacement.
pub(in crate::study::run) struct Colouring<'a> {
    pub(in crate::study::run) anatomy: &'a Anatomy,
    pub(in crate::study::run) frames: &'a [FrameState],
    pub(in crate::study::run) model: Option<(&'a HeartModel, &'a Trajectory)>,
}

/// Slices, where there are images, and the mesh.
pub(in crate::study::run) fn motion_section(
    clock: &Clock,
    frames: &Frames,
    scene: Option<&ImageScene>,
    colouring: &Colouring,
) -> Result<Section, RunError> {
    let mut blocks = Vec::new();
    if let Some(scene) = scene {
        let montage = every_frame(scene, &frames.places)?;
        if !montage.panels.is_empty() {
            let about = "The images with the contours of the heart's surfaces on them, through the beat: play, or move the slider below.";
            blocks.extend([Block::Text(about.into()), Block::Slices(Slices(montage))]);
        }
    }
    if !frames.places.is_empty() {
        blocks.push(Block::Text("The beating mesh, coloured by what its wall does:".into()));
        blocks.push(Block::Heart(beating_heart(clock, frames, colouring)));
    }
    Ok(Section { title: "Through the beat".into(), blocks })
}

/// The mesh at rest, coloured by the depth of its wall.
pub(in crate::study::run) fn resting_heart(anatomy: &Anatomy) -> BeatingHeart {
    let surface = Boundary::new(anatomy);
    let segments: Vec<f64> = anatomy.aha_segments.iter().map(|&segment| f64::from(segment)).collect();
    let field = |name: &str, values| SurfaceField {
        name: name.into(),
        unit: String::new(),
        values: SurfaceValues::Constant(values),
        scale: Scale::Sequential,
    };
    let fields = vec![
        field("Depth of the wall, endocardium to epicardium", surface.of_vertices(|vertex| anatomy.transmural_depth[vertex])),
        field("AHA segment", surface.of_tetrahedra(&segments)),
    ];
    let position_mm = surface.vertices.iter().map(|&vertex| anatomy.mesh.vertices_mm()[vertex]).collect();
    BeatingHeart { frames_mm: vec![position_mm], parts: surface.parts.clone(), fields, views: views(anatomy) }
}

fn beating_heart(clock: &Clock, frames: &Frames, colouring: &Colouring) -> BeatingHeart {
    let anatomy = colouring.anatomy;
    let surface = Boundary::new(anatomy);
    let states: Vec<&FrameState> = frames.places.iter().map(|&place| &colouring.frames[place]).collect();
    let rest_mm = anatomy.mesh.vertices_mm();
    let displacement = |state: &&FrameState| surface.of_vertices(|vertex| (state.position_mm[vertex] - rest_mm[vertex]).norm());
    let mut fields =
        colouring.model.map(|(model, trajectory)| model_fields(&surface, model, trajectory, clock, &states)).unwrap_or_default();
    fields.push(SurfaceField {
        name: "Displacement from rest".into(),
        unit: "mm".into(),
        values: SurfaceValues::ByFrame(states.iter().map(displacement).collect()),
        scale: Scale::Sequential,
    });
    let positions = |state: &&FrameState| surface.vertices.iter().map(|&vertex| state.position_mm[vertex]).collect();
    BeatingHeart { frames_mm: states.iter().map(positions).collect(), parts: surface.parts.clone(), fields, views: views(anatomy) }
}

fn model_fields(
    surface: &Boundary,
    model: &HeartModel,
    trajectory: &Trajectory,
    clock: &Clock,
    states: &[&FrameState],
) -> Vec<SurfaceField> {
    let anatomy = model.anatomy();
    let times_s = model.activation().times_s();
    let beat = deformation(model, trajectory, clock);
    let reference_mm: &[Vector3<f64>] = beat.as_ref().map_or(anatomy.mesh.vertices_mm(), |beat| &beat.reference_mm);
    let stress = |state: &&FrameState| surface.of_tetrahedra(&model.active_stress_kpa(state.time_s));
    let strains: Vec<Vec<Strain>> = states.iter().map(|state| Strain::of_tetrahedra(anatomy, reference_mm, &state.position_mm)).collect();
    let strain = |name: &str, value: fn(&Strain) -> f64| {
        let of_frame =
            |strains: &Vec<Strain>| surface.of_tetrahedra(&strains.iter().map(|strain| 100.0 * value(strain)).collect::<Vec<_>>());
        SurfaceField {
            name: name.into(),
            unit: "%".into(),
            values: SurfaceValues::ByFrame(strains.iter().map(of_frame).collect()),
            scale: Scale::Diverging,
        }
    };
    vec![
        SurfaceField {
            name: "Activation".into(),
            unit: "ms".into(),
            values: SurfaceValues::Constant(surface.of_vertices(|vertex| MS_PER_S * times_s[vertex])),
            scale: Scale::Sequential,
        },
        SurfaceField {
            name: "Active stress (contraction)".into(),
            unit: "kPa".into(),
            values: SurfaceValues::ByFrame(states.iter().map(stress).collect()),
            scale: Scale::Sequential,
        },
        strain("Circumferential strain", |strain| strain.circumferential),
        strain("Longitudinal strain", |strain| strain.longitudinal),
        strain("Radial strain", |strain| strain.radial),
    ]
}

/// The boundary of a mesh with vertices of its own.
struct Boundary<'a> {
    anatomy: &'a Anatomy,
    /// The mesh's vertices that lie on it.
    vertices: Vec<usize>,
    /// Its parts with their triangles of own vertices.
    parts: Vec<(String, Vec<[usize; 3]>)>,
    /// Tetrahedra at each own vertex with their volumes, mm³.
    around: Vec<Vec<(usize, f64)>>,
}

const PARTS: [(SurfaceTag, &str); 4] = [
    (SurfaceTag::Epicardium, "epicardium"),
    (SurfaceTag::EndocardiumLv, "LV endocardium"),
    (SurfaceTag::EndocardiumRv, "RV endocardium"),
    (SurfaceTag::Base, "base"),
];

impl<'a> Boundary<'a> {
    fn new(anatomy: &'a Anatomy) -> Self {
        let mut own = vec![None; anatomy.mesh.vertex_count()];
        let mut vertices = Vec::new();
        for &vertex in anatomy.surface.triangles().iter().flatten() {
            if own[vertex].is_none() {
                own[vertex] = Some(vertices.len());
                vertices.push(vertex);
            }
        }
        let triangles = |tag| anatomy.surface.triangles_with(tag).map(|corners| corners.map(|vertex| own[vertex].unwrap_or(0))).collect();
        let parts = PARTS.iter().map(|&(tag, name)| (name.to_owned(), triangles(tag)));
        let parts = parts.filter(|(_, triangles): &(String, Vec<[usize; 3]>)| !triangles.is_empty()).collect();
        let mut around = vec![Vec::new(); vertices.len()];
        for (tetrahedron, corners) in anatomy.mesh.tetrahedra().iter().enumerate() {
            let volume_mm3 = anatomy.mesh.volume_mm3(tetrahedron);
            corners.iter().filter_map(|&vertex| own[vertex]).for_each(|own: usize| around[own].push((tetrahedron, volume_mm3)));
        }
        Self { anatomy, vertices, parts, around }
    }

    fn of_vertices(&self, value: impl Fn(usize) -> f64) -> Vec<f64> {
        self.vertices.iter().map(|&vertex| value(vertex)).collect()
    }

    /// Means over the tetrahedra at each vertex, weighted by volume; what is not a number does not count.
    fn of_tetrahedra(&self, values: &[f64]) -> Vec<f64> {
        debug_assert_eq!(values.len(), self.anatomy.mesh.tetrahedron_count());
        let mean = |tetrahedra: &Vec<(usize, f64)>| {
            let known = tetrahedra.iter().filter(|(tetrahedron, _)| values[*tetrahedron].is_finite());
            let (sum, weight) = known.fold((0.0, 0.0), |(sum, weight), &(t, volume)| (sum + volume * values[t], weight + volume));
            if weight > 0.0 { sum / weight } else { f64::NAN }
        };
        self.around.iter().map(mean).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::mesher::MesherSettings;
    use crate::anatomy::{AnatomySettings, IdealisedBiventricle};

    #[test]
    fn the_boundary_keeps_its_triangles_and_a_constant_its_value() {
        let anatomy =
            IdealisedBiventricle::default().build(&MesherSettings::with_edge_length_mm(12.0), &AnatomySettings::default()).unwrap();
        let boundary = Boundary::new(&anatomy);
        let count: usize = boundary.parts.iter().map(|(_, triangles)| triangles.len()).sum();
        assert_eq!((count, boundary.parts.len()), (anatomy.surface.triangles().len(), 4));
        let first = boundary.parts[0].1[0].map(|own| boundary.vertices[own]);
        assert_eq!(Some(first), anatomy.surface.triangles_with(SurfaceTag::Epicardium).next());
        let mut values = vec![7.0; anatomy.mesh.tetrahedron_count()];
        values[3] = f64::NAN;
        assert!(boundary.of_tetrahedra(&values).iter().all(|value| (value - 7.0).abs() < 1e-12));
    }
}
