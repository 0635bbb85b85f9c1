//! Where and when the ventricles are first depolarised, and how fast the depolarisation runs, \[Billet2009\] §2.

use nalgebra::Vector3;

use super::{HeartError, Parameter, Parameters};
use crate::anatomy::{Anatomy, Ventricle};
use crate::electrophysiology::{Conduction, Onset, nearest_vertex};
use crate::mesh::SurfaceTag;

/// The sites where a beat starts.
#[derive(Debug, Clone, PartialEq)]
pub enum OnsetSites {
    /// Endings of the Purkinje network in a normal heart. Left: the three places of \[Durrer1970\] (mid-septum, anterior and posterior
    /// paraseptal), then, 10 ms later, the walls at the roots of the two papillary muscles. Right: the middle of the free wall, at the
    /// root of its anterior papillary muscle, 5 ms late. Heights along the axis and angles from the septum are chosen.
    Normal,
    /// Left bundle branch block: the right ventricle's site alone. A heart without right ventricle is entered where that front would come
    /// through: from the right side of the septum.
    LeftBundleBranchBlock,
    /// A pacing lead in the apex of the right ventricle, and nothing else.
    RightApicalPacing,
    /// Resynchronisation: a lead in the apex of the right ventricle, and one on the lateral wall of the left, from outside.
    BiventricularPacing,
    /// The whole endocardium of the left ventricle at once.
    Endocardium,
    /// The vertices nearest to these points (world, mm), each with its delay (s) after `onset_time_s`.
    Points(Vec<(Vector3<f64>, f64)>),
    /// These vertices, each with its delay (s) after `onset_time_s`.
    Vertices(Vec<(usize, f64)>),
    /// All of these: a rhythm of the heart's own, say, and pacing leads beside it.
    Together(Vec<OnsetSites>),
}

/// A site by fraction of the way from apex to base, angle from the septal direction (degrees), and delay (s).
type Site = (f64, f64, f64);

const LEFT_SITES: [Site; 5] = [(0.5, 0.0, 0.0), (0.6, 60.0, 0.0), (0.35, -60.0, 0.0), (0.4, 140.0, 0.01), (0.4, -140.0, 0.01)];
const RIGHT_SITE: Site = (0.4, 0.0, 0.005);
const RIGHT_APEX_HEIGHT: f64 = 0.05;
const LATERAL_LEAD: Site = (0.6, 180.0, 0.0);

impl OnsetSites {
    /// The onsets on an anatomy, at `onset_time_s` and later.
    pub(super) fn onsets(&self, anatomy: &Anatomy, parameters: &Parameters) -> Vec<Onset> {
        let start_s = parameters[Parameter::OnsetTime];
        self.sites(anatomy).into_iter().map(|(vertex, delay_s)| Onset { vertex, time_s: start_s + delay_s }).collect()
    }

    /// Vertices with their delays, s.
    fn sites(&self, anatomy: &Anatomy) -> Vec<(usize, f64)> {
        let at_once = |vertex: usize| (vertex, 0.0);
        match self {
            Self::Normal => normal_sites(anatomy).collect(),
            Self::LeftBundleBranchBlock => right_entry(anatomy, RIGHT_SITE.0).map(at_once).into_iter().collect(),
            Self::RightApicalPacing => right_entry(anatomy, RIGHT_APEX_HEIGHT).map(at_once).into_iter().collect(),
            Self::BiventricularPacing => {
                let lateral = WallPatch::new(anatomy, SurfaceTag::Epicardium).nearest(&LATERAL_LEAD);
                right_entry(anatomy, RIGHT_APEX_HEIGHT).into_iter().chain(lateral).map(at_once).collect()
            }
            Self::Endocardium => anatomy.surface.vertices_with(SurfaceTag::EndocardiumLv).into_iter().map(at_once).collect(),
            Self::Points(points) => {
                let vertices_mm = anatomy.mesh.vertices_mm();
                points.iter().filter_map(|(point, delay_s)| Some((nearest_vertex(vertices_mm, point)?, *delay_s))).collect()
            }
            Self::Vertices(sites) => sites.clone(),
            Self::Together(parts) => parts.iter().flat_map(|part| part.sites(anatomy)).collect(),
        }
    }
}

fn normal_sites(anatomy: &Anatomy) -> impl Iterator<Item = (usize, f64)> + '_ {
    anatomy.cavities.iter().flat_map(|&(ventricle, _)| {
        let endocardium = WallPatch::new(anatomy, ventricle.endocardium());
        let sites: Vec<(usize, f64)> = match ventricle {
            Ventricle::Left => LEFT_SITES.iter().filter_map(|site| Some((endocardium.nearest(site)?, site.2))).collect(),
            Ventricle::Right => endocardium.farthest_from_axis(RIGHT_SITE.0).map(|vertex| (vertex, RIGHT_SITE.2)).into_iter().collect(),
        };
        sites
    })
}

/// Where the right ventricle is depolarised at a height, or, without one, the right side of the septum.
fn right_entry(anatomy: &Anatomy, height: f64) -> Option<usize> {
    if anatomy.cavities.iter().any(|&(ventricle, _)| ventricle == Ventricle::Right) {
        WallPatch::new(anatomy, SurfaceTag::EndocardiumRv).farthest_from_axis(height)
    } else {
        WallPatch::new(anatomy, SurfaceTag::Epicardium).nearest(&(height, 0.0, 0.0))
    }
}

/// Cylindrical coordinates of a surface's vertices about the long axis.
struct WallPatch {
    vertices: Vec<usize>,
    /// Height from apex (0) to base (length), angle from the septum (rad), distance from the axis (mm).
    coordinates: Vec<(f64, f64, f64)>,
    length_mm: f64,
    radius_mm: f64,
}

impl WallPatch {
    fn new(anatomy: &Anatomy, tag: SurfaceTag) -> Self {
        let axes = &anatomy.axes;
        let across = axes.long_axis.cross(&axes.septal_direction);
        let vertices = anatomy.surface.vertices_with(tag);
        let offset = |&vertex: &usize| anatomy.mesh.vertices_mm()[vertex] - axes.base_centre_mm;
        let length_mm = vertices.iter().map(|v| -offset(v).dot(&axes.long_axis)).fold(f64::MIN_POSITIVE, f64::max);
        let coordinates: Vec<(f64, f64, f64)> = vertices
            .iter()
            .map(|vertex| {
                let offset: Vector3<f64> = offset(vertex);
                let (x, y) = (offset.dot(&axes.septal_direction), offset.dot(&across));
                (length_mm + offset.dot(&axes.long_axis), y.atan2(x), x.hypot(y))
            })
            .collect();
        let radius_mm = coordinates.iter().map(|c| c.2).sum::<f64>() / coordinates.len().max(1) as f64;
        Self { vertices, coordinates, length_mm, radius_mm }
    }

    fn nearest(&self, &(height, angle_deg, _): &Site) -> Option<usize> {
        let mismatch = |&(z, angle, _): &(f64, f64, f64)| {
            let turn = (angle - angle_deg.to_radians()).sin().atan2((angle - angle_deg.to_radians()).cos());
            (z - height * self.length_mm).powi(2) + (turn * self.radius_mm).powi(2)
        };
        self.least(mismatch)
    }

    fn farthest_from_axis(&self, height: f64) -> Option<usize> {
        self.least(|&(z, _, radius)| (z - height * self.length_mm).powi(2) - radius * radius)
    }

    fn least(&self, mismatch: impl Fn(&(f64, f64, f64)) -> f64) -> Option<usize> {
        let order = |&(_, a): &(usize, f64), &(_, b): &(usize, f64)| a.total_cmp(&b);
        self.vertices.iter().zip(&self.coordinates).map(|(&vertex, c)| (vertex, mismatch(c))).min_by(order).map(|(vertex, _)| vertex)
    }
}

/// Speed v along the fibre of every tetrahedron, `endocardial_speed_factor` times faster in the endocardial layer.
pub(super) fn conduction(anatomy: &Anatomy, parameters: &Parameters) -> Result<Conduction, HeartError> {
    let factor = parameters[Parameter::EndocardialSpeedFactor];
    let bulk = parameters.on_tetrahedra(Parameter::ConductionVelocity, anatomy);
    let speed = |(is_layer, bulk): (bool, f64)| if is_layer { bulk * factor } else { bulk };
    let speeds = endocardial_layer(anatomy).into_iter().zip(bulk).map(speed).collect();
    let fibres = anatomy.fibre_axes.iter().map(|axes| axes.column(0).into_owned()).collect();
    Ok(Conduction::new(speeds, parameters[Parameter::AnisotropyRatio], fibres)?)
}

/// Tetrahedra with a face on an endocardium: the thin layer of the Purkinje network.
pub(super) fn endocardial_layer(anatomy: &Anatomy) -> Vec<bool> {
    let mut touches = vec![false; anatomy.mesh.vertex_count()];
    for &(ventricle, _) in &anatomy.cavities {
        for vertex in anatomy.surface.vertices_with(ventricle.endocardium()) {
            touches[vertex] = true;
        }
    }
    let has_face = |corners: &[usize; 4]| corners.iter().filter(|&&vertex| touches[vertex]).count() >= 3;
    anatomy.mesh.tetrahedra().iter().map(has_face).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::anatomy::mesher::MesherSettings;
    use crate::anatomy::{AnatomySettings, IdealisedBiventricle, Region};
    use crate::electrophysiology::{ActivationMap, activate};
    use crate::heart::ActivationTimes;
    use crate::heart::idealised_lv::IdealisedLv;

    fn map(anatomy: &Anatomy, sites: &OnsetSites, parameters: &Parameters) -> ActivationMap {
        activate(&anatomy.mesh, &conduction(anatomy, parameters).unwrap(), &sites.onsets(anatomy, parameters)).unwrap()
    }

    fn span_s(sites: &OnsetSites, parameters: &Parameters) -> (f64, f64) {
        map(&IdealisedLv::default().anatomy(), sites, parameters).span_s()
    }

    /// Mean td of the elements of a region.
    fn mean_s(anatomy: &Anatomy, map: &ActivationMap, region: Region) -> f64 {
        let times_s = map.tetrahedron_times_s(&anatomy.mesh);
        let there: Vec<f64> = times_s.into_iter().zip(&anatomy.regions).filter(|(_, r)| **r == region).map(|(t, _)| t).collect();
        there.iter().sum::<f64>() / there.len() as f64
    }

    /// Two leads make a block's long QRS shorter again: what resynchronisation is for.
    #[test]
    fn the_left_ventricle_is_late_in_left_bundle_branch_block_and_pacing_it_helps() {
        let mesher = MesherSettings::with_edge_length_mm(7.0);
        let anatomy = IdealisedBiventricle::default().build(&mesher, &AnatomySettings::default()).unwrap();
        let late_s = |map: &ActivationMap| mean_s(&anatomy, map, Region::FreeWallLv) - mean_s(&anatomy, map, Region::FreeWallRv);
        let [normal, block, apical, both] =
            [OnsetSites::Normal, OnsetSites::LeftBundleBranchBlock, OnsetSites::RightApicalPacing, OnsetSites::BiventricularPacing]
                .map(|sites| map(&anatomy, &sites, &Parameters::default()));
        let total_s = |map: &ActivationMap| ActivationTimes::new(&anatomy, map).total_s;
        assert!(late_s(&normal).abs() < 0.02, "{}", late_s(&normal));
        assert!(late_s(&block) > 0.03 && late_s(&apical) > 0.02, "{} {}", late_s(&block), late_s(&apical));
        assert!(total_s(&block) > 1.3 * total_s(&normal), "{} {}", total_s(&block), total_s(&normal));
        assert!(total_s(&both) < 0.9 * total_s(&apical), "{} {}", total_s(&both), total_s(&apical));
        let times = ActivationTimes::new(&anatomy, &block);
        assert!(times.left_s <= times.total_s && times.right_s.unwrap() <= times.total_s);
    }

    #[test]
    fn without_a_right_ventricle_the_block_comes_through_the_septum() {
        let anatomy = IdealisedLv::default().anatomy();
        let onsets = OnsetSites::LeftBundleBranchBlock.onsets(&anatomy, &Parameters::default());
        let [onset] = onsets.as_slice() else { unreachable!("one site") };
        let offset_mm = anatomy.mesh.vertices_mm()[onset.vertex] - anatomy.axes.base_centre_mm;
        let across_mm = offset_mm - anatomy.axes.long_axis * offset_mm.dot(&anatomy.axes.long_axis);
        assert!(across_mm.normalize().dot(&anatomy.axes.septal_direction) > 0.95);
        assert!(anatomy.surface.vertices_with(SurfaceTag::Epicardium).contains(&onset.vertex));
        let lead = OnsetSites::Together(vec![OnsetSites::LeftBundleBranchBlock, OnsetSites::Vertices(vec![(3, 0.01)])]);
        let start_s = Parameters::default()[Parameter::OnsetTime];
        assert_eq!(lead.onsets(&anatomy, &Parameters::default()), [*onset, Onset { vertex: 3, time_s: start_s + 0.01 }]);
    }

    /// A normal left ventricle is activated in 60–90 ms [Durrer1970].
    #[test]
    fn a_normal_left_ventricle_is_activated_within_a_normal_time() {
        let (first_s, last_s) = span_s(&OnsetSites::Normal, &Parameters::default());
        assert_eq!(first_s, Parameters::default()[Parameter::OnsetTime]);
        assert!((0.045..0.09).contains(&(last_s - first_s)), "{} ms", (last_s - first_s) * 1e3);
    }

    /// From the whole endocardium the front crosses a wall of 9.5 mm across the fibres: 9.5/(v√ρ) at most, faster in the first layer.
    #[test]
    fn the_endocardium_at_once_leaves_the_wall_to_cross() {
        let parameters = Parameters::default();
        let (first_s, last_s) = span_s(&OnsetSites::Endocardium, &parameters);
        let across_mm_per_s = parameters[Parameter::ConductionVelocity] * parameters[Parameter::AnisotropyRatio].sqrt();
        assert!(last_s - first_s < 9.6 / across_mm_per_s && last_s - first_s > 4.0 / across_mm_per_s);
    }

    #[test]
    fn points_find_their_vertices_and_keep_their_delays() {
        let anatomy = IdealisedLv::default().anatomy();
        let point = anatomy.mesh.vertices_mm()[37] + Vector3::repeat(0.01);
        let onsets = OnsetSites::Points(vec![(point, 0.004)]).onsets(&anatomy, &Parameters::default());
        let start_s = Parameters::default()[Parameter::OnsetTime];
        assert_eq!(onsets, [Onset { vertex: 37, time_s: start_s + 0.004 }]);
    }
}
