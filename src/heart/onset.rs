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
    /// The whole endocardium of the left ventricle at once.
    Endocardium,
    /// The vertices nearest to these points (world, mm), each with its delay (s) after `onset_time_s`.
    Points(Vec<(Vector3<f64>, f64)>),
    /// These vertices, each with its delay (s) after `onset_time_s`.
    Vertices(Vec<(usize, f64)>),
}

/// A site by fraction of the way from apex to base, angle from the septal direction (degrees), and delay (s).
type Site = (f64, f64, f64);

const LEFT_SITES: [Site; 5] = [(0.5, 0.0, 0.0), (0.6, 60.0, 0.0), (0.35, -60.0, 0.0), (0.4, 140.0, 0.01), (0.4, -140.0, 0.01)];
const RIGHT_SITE: Site = (0.4, 0.0, 0.005);

impl OnsetSites {
    /// The onsets on an anatomy, at `onset_time_s` and later.
    pub(super) fn onsets(&self, anatomy: &Anatomy, parameters: &Parameters) -> Vec<Onset> {
        let start_s = parameters[Parameter::OnsetTime];
        let sites: Vec<(usize, f64)> = match self {
            Self::Normal => normal_sites(anatomy).collect(),
            Self::Endocardium => anatomy.surface.vertices_with(SurfaceTag::EndocardiumLv).into_iter().map(|v| (v, 0.0)).collect(),
            Self::Points(points) => {
                let vertices_mm = anatomy.mesh.vertices_mm();
                points.iter().filter_map(|(point, delay_s)| Some((nearest_vertex(vertices_mm, point)?, *delay_s))).collect()
            }
            Self::Vertices(sites) => sites.clone(),
        };
        sites.into_iter().map(|(vertex, delay_s)| Onset { vertex, time_s: start_s + delay_s }).collect()
    }
}

fn normal_sites(anatomy: &Anatomy) -> impl Iterator<Item = (usize, f64)> + '_ {
    anatomy.cavities.iter().flat_map(|&(ventricle, _)| {
        let endocardium = Endocardium::new(anatomy, ventricle);
        let sites: Vec<(usize, f64)> = match ventricle {
            Ventricle::Left => LEFT_SITES.iter().filter_map(|site| Some((endocardium.nearest(site)?, site.2))).collect(),
            Ventricle::Right => endocardium.farthest_from_axis(RIGHT_SITE.0).map(|vertex| (vertex, RIGHT_SITE.2)).into_iter().collect(),
        };
        sites
    })
}

/// Cylindrical coordinates of the endocardial vertices about the long axis.
struct Endocardium {
    vertices: Vec<usize>,
    /// Height from apex (0) to base (length), angle from the septum (rad), distance from the axis (mm).
    coordinates: Vec<(f64, f64, f64)>,
    length_mm: f64,
    radius_mm: f64,
}

impl Endocardium {
    fn new(anatomy: &Anatomy, ventricle: Ventricle) -> Self {
        let axes = &anatomy.axes;
        let across = axes.long_axis.cross(&axes.septal_direction);
        let vertices = anatomy.surface.vertices_with(ventricle.endocardium());
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

/// Speed v along the fibre of every tetrahedron, `endocardial_speed_factor` times faster in those with a face on an endocardium: the
/// thin layer of the Purkinje network.
pub(super) fn conduction(anatomy: &Anatomy, parameters: &Parameters) -> Result<Conduction, HeartError> {
    let mut touches = vec![false; anatomy.mesh.vertex_count()];
    for &(ventricle, _) in &anatomy.cavities {
        for vertex in anatomy.surface.vertices_with(ventricle.endocardium()) {
            touches[vertex] = true;
        }
    }
    let bulk = parameters[Parameter::ConductionVelocity];
    let layer = bulk * parameters[Parameter::EndocardialSpeedFactor];
    let has_face = |corners: &[usize; 4]| corners.iter().filter(|&&vertex| touches[vertex]).count() >= 3;
    let speeds = anatomy.mesh.tetrahedra().iter().map(|corners| if has_face(corners) { layer } else { bulk }).collect();
    let fibres = anatomy.fibre_axes.iter().map(|axes| axes.column(0).into_owned()).collect();
    Ok(Conduction::new(speeds, parameters[Parameter::AnisotropyRatio], fibres)?)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heart::idealised_lv::IdealisedLv;

    fn span_s(sites: &OnsetSites, parameters: &Parameters) -> (f64, f64) {
        let anatomy = IdealisedLv::default().anatomy();
        let onsets = sites.onsets(&anatomy, parameters);
        let map = crate::electrophysiology::activate(&anatomy.mesh, &conduction(&anatomy, parameters).unwrap(), &onsets).unwrap();
        map.span_s()
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
