//! Claims about hearts with two ventricles.

use std::ops::ControlFlow;
use std::sync::Arc;

use nalgebra::Vector3;

use super::idealised_lv::IdealisedLv;
use super::*;
use crate::anatomy::mesher::MesherSettings;
use crate::anatomy::{Anatomy, AnatomySettings, IdealisedBiventricle, Region, Ventricle};
use crate::circulation::Phase;
use crate::mesh::{Cavity, SurfaceTag, TaggedSurface, TetMesh};

/// The same chamber as a right ventricle, elsewhere.
fn as_right(left: &Anatomy, shift_mm: Vector3<f64>) -> Anatomy {
    let vertices = left.mesh.vertices_mm().iter().map(|x| x + shift_mm).collect();
    let mesh = TetMesh::new(vertices, left.mesh.tetrahedra().to_vec()).unwrap();
    let tags = left.surface.tags().iter().map(|&tag| if tag == SurfaceTag::EndocardiumLv { SurfaceTag::EndocardiumRv } else { tag });
    let surface = TaggedSurface::new(&mesh, tags.collect()).unwrap();
    let cavities = vec![(Ventricle::Right, Cavity::new(&surface, SurfaceTag::EndocardiumRv).unwrap())];
    let regions = vec![Region::FreeWallRv; mesh.tetrahedron_count()];
    Anatomy { mesh, surface, cavities, regions, ..left.clone() }
}

/// Both chambers in one mesh, touching nowhere.
fn side_by_side(left: &Anatomy, right: &Anatomy) -> Anatomy {
    let offset = left.mesh.vertex_count();
    let vertices = [left.mesh.vertices_mm(), right.mesh.vertices_mm()].concat();
    let shifted = right.mesh.tetrahedra().iter().map(|corners| corners.map(|vertex| vertex + offset));
    let mesh = TetMesh::new(vertices, left.mesh.tetrahedra().iter().copied().chain(shifted).collect()).unwrap();
    let surface = TaggedSurface::new(&mesh, [left.surface.tags(), right.surface.tags()].concat()).unwrap();
    Anatomy {
        cavities: Anatomy::close_cavities(&surface).unwrap(),
        transmural_depth: [&left.transmural_depth[..], &right.transmural_depth].concat(),
        fibre_axes: [&left.fibre_axes[..], &right.fibre_axes].concat(),
        heart_axes: [&left.heart_axes[..], &right.heart_axes].concat(),
        regions: [&left.regions[..], &right.regions].concat(),
        aha_segments: left.aha_segments.iter().copied().chain(right.aha_segments.iter().map(|_| 0)).collect(),
        axes: left.axes,
        mesh,
        surface,
    }
}

fn beat(anatomy: Anatomy, onsets: Vec<(usize, f64)>) -> Vec<CurveRow> {
    let settings = ModelSettings { onset_sites: OnsetSites::Vertices(onsets), ..ModelSettings::default() };
    let model = HeartModel::new(Arc::new(anatomy), Parameters::default(), settings).unwrap();
    let plan = SimulationPlan { start_time_s: -0.05, end_time_s: 0.8, frame_times_s: vec![] };
    simulate(&model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap().curves
}

/// The valve problem of four flows falls apart into two of two: any mixing of the ventricles' pressures, ports or volumes would show.
#[test]
fn ventricles_that_touch_nowhere_beat_as_each_does_alone() {
    let left = IdealisedLv { resolution: [12, 6, 1], ..IdealisedLv::default() }.anatomy();
    let right = as_right(&left, Vector3::new(100.0, 0.0, 0.0));
    let (site, offset) = (40, left.mesh.vertex_count());
    let both = beat(side_by_side(&left, &right), vec![(site, 0.0), (site + offset, 0.004)]);
    for (alone, ventricle) in [(beat(left, vec![(site, 0.0)]), Ventricle::Left), (beat(right, vec![(site, 0.004)]), Ventricle::Right)] {
        for (a, b) in alone.iter().zip(&both) {
            let [a, b] = [a, b].map(|row| row.ventricle(ventricle).unwrap());
            assert_eq!(a.phase, b.phase, "{ventricle:?}: {a:?} {b:?}");
            let differences =
                [a.volume_ml - b.volume_ml, a.pressure_kpa - b.pressure_kpa, a.arterial_pressure_kpa - b.arterial_pressure_kpa];
            assert!(differences.iter().all(|d| d.abs() < 1e-4), "{ventricle:?}: {a:?} {b:?}");
        }
    }
    let ejected = |volume: fn(&CurveRow) -> Option<f64>| {
        let volumes = both.iter().filter_map(volume);
        volumes.clone().fold(0.0, f64::max) - volumes.fold(f64::INFINITY, f64::min)
    };
    assert!(ejected(|row| row.volume_lv_ml) > 20.0 && ejected(|row| row.volume_rv_ml) > 20.0, "both eject");
}

/// Two ventricles with a common septum pull at each other's volumes; both must be met all the same, and both go through the four phases.
#[test]
fn two_ventricles_with_a_septum_conserve_blood_through_the_four_phases() {
    let mesher = MesherSettings::with_edge_length_mm(9.0);
    let anatomy = IdealisedBiventricle::default().build(&mesher, &AnatomySettings::default()).unwrap();
    let model = HeartModel::new(Arc::new(anatomy), Parameters::default(), ModelSettings::default()).unwrap();
    let plan = SimulationPlan { start_time_s: -0.15, end_time_s: 0.65, frame_times_s: vec![] };
    let curves = simulate(&model, &plan, &[], &mut |_, _| ControlFlow::Continue(())).unwrap().curves;
    for ventricle in [Ventricle::Left, Ventricle::Right] {
        let rows: Vec<(f64, VentricleCurve)> = curves.iter().map(|row| (row.time_s, row.ventricle(ventricle).unwrap())).collect();
        for pair in rows.windows(2) {
            let ((start_s, before), (end_s, after)) = (pair[0], pair[1]);
            let sent_ml = (end_s - start_s) * (after.inflow_ml_per_s - after.outflow_ml_per_s);
            assert!((after.volume_ml - before.volume_ml - sent_ml).abs() < 1.01e-6, "{ventricle:?} at {end_s} s");
        }
        let mut phases: Vec<Phase> = rows.iter().map(|(_, curve)| curve.phase).collect();
        phases.dedup();
        assert_eq!(phases[..1], [Phase::Filling], "{ventricle:?}: {phases:?}");
        assert_eq!(phases[1..], Phase::CYCLE, "{ventricle:?}");
    }
}
