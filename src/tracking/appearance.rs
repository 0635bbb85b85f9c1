//! What a surface looks like on the reference frame: the threshold and intensity range of \[Billet2009\] §4.1, learnt once and kept.

use nalgebra::Vector3;

use super::thickness::thickness_mm;
use super::{ImageInstant, TrackingError};
use crate::mesh::{SurfaceTag, TaggedSurface};

/// How the appearance of a surface is learnt.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AppearanceSettings {
    /// The two sides of the boundary are read between these distances from it, mm; in a wall that is thinner than
    /// `side_to_mm / WALL_SHARE_TO`, within it.
    pub side_from_mm: f64,
    /// See [`AppearanceSettings::side_from_mm`].
    pub side_to_mm: f64,
    /// Gradient-norm threshold as a fraction of the median gradient norm at the surface.
    pub gradient_fraction: f64,
    /// The intensity range is the interval between this quantile and its mirror image of the intensities at the surface.
    pub intensity_quantile: f64,
    /// Rounds of averaging with neighbours along the surface.
    pub smoothing_rounds: usize,
}

impl Default for AppearanceSettings {
    fn default() -> Self {
        Self { side_from_mm: 1.5, side_to_mm: 4.0, gradient_fraction: 0.35, intensity_quantile: 0.02, smoothing_rounds: 6 }
    }
}

/// A thin wall is read between these shares of its thickness.
const WALL_SHARE_FROM: f64 = 0.35;
const WALL_SHARE_TO: f64 = 0.75;

impl AppearanceSettings {
    /// Where the wall's own side is read, mm from the boundary: the right ventricle's is 3 mm thick, and beyond it is something else.
    fn inner_span_mm(&self, thickness_mm: f64) -> [f64; 2] {
        [self.side_from_mm.min(WALL_SHARE_FROM * thickness_mm), self.side_to_mm.min(WALL_SHARE_TO * thickness_mm)]
    }

    /// A wall as thick as this is read like any thicker one.
    fn thin_below_mm(&self) -> f64 {
        (self.side_from_mm / WALL_SHARE_FROM).max(self.side_to_mm / WALL_SHARE_TO)
    }

    /// Where the other side is read, mm from the boundary.
    pub(super) fn outer_span_mm(&self) -> [f64; 2] {
        [self.side_from_mm, self.side_to_mm]
    }
}

/// The learnt appearance of one surface. Lists are by place in `vertices`.
///
/// With $I_-$ and $I_+$ the intensities on the myocardial and on the outer side of vertex $i$ (medians over a short stretch of
/// its normal, averaged along the surface), the boundary is where the profile crosses $\ell_i = I_- + f (I_+ - I_-)$ in the
/// learnt sense, with one fraction $f$ a surface: the median over the vertices of where the mesh itself stands on the reference
/// frame. So the boundary points of that frame lie on the mesh on average, whatever side of the edge the contours were drawn on.
#[derive(Debug, Clone, PartialEq)]
pub struct SurfaceAppearance {
    /// The surface.
    pub tag: SurfaceTag,
    /// Its vertices, ascending.
    pub vertices: Vec<usize>,
    /// For every vertex its neighbours along the surface, as places in `vertices`.
    pub neighbours: Vec<Vec<usize>>,
    /// The wall's own side is read between these distances from the boundary, mm.
    pub inner_span_mm: Vec<[f64; 2]>,
    /// Intensity at the boundary, within `intensity_range`.
    pub level: Vec<f64>,
    /// Outer minus myocardial intensity: positive where the outside is brighter (blood at the endocardium).
    pub contrast: Vec<f64>,
    /// Median of the absolute contrast.
    pub contrast_median: f64,
    /// Fraction f of the contrast at which the boundary stands.
    pub fraction: f64,
    /// Smallest gradient norm of a boundary point, 1/mm.
    pub gradient_threshold_per_mm: f64,
    /// Range of the intensities of boundary points.
    pub intensity_range: (f64, f64),
}

impl SurfaceAppearance {
    /// Learns the appearance of the surface `tag` of a mesh at `position_mm` from the image of the same instant.
    ///
    /// # Errors
    /// [`TrackingError::MissingSurface`], [`TrackingError::NotCovered`] if less than half of the vertices lie inside the image,
    /// [`TrackingError::NoContrast`] if the two sides do not differ by more than the noise.
    pub fn learn(
        surface: &TaggedSurface,
        tag: SurfaceTag,
        position_mm: &[Vector3<f64>],
        (instant, time_s): (&ImageInstant, f64),
        settings: &AppearanceSettings,
    ) -> Result<Self, TrackingError> {
        let vertices = surface.vertices_with(tag);
        if vertices.is_empty() {
            return Err(TrackingError::MissingSurface { tag });
        }
        let neighbours = neighbours_along(surface, tag, &vertices);
        let area_mm2 = surface.vertex_area_vectors_mm2(tag, position_mm);
        let thickness_mm = thickness_mm(surface, tag, &vertices, &area_mm2, position_mm, settings.thin_below_mm());
        let inner_span_mm: Vec<[f64; 2]> = thickness_mm.into_iter().map(|thickness_mm| settings.inner_span_mm(thickness_mm)).collect();
        let sides = read_sides(&vertices, &inner_span_mm, &area_mm2, position_mm, instant, settings.outer_span_mm());
        let seen: Vec<&Sides> = sides.iter().flatten().collect();
        if 2 * seen.len() < vertices.len() {
            return Err(TrackingError::NotCovered { tag, covered: seen.len(), vertex_count: vertices.len() });
        }
        let smooth = |pick: fn(&Sides) -> f64| {
            let raw: Vec<Option<f64>> = sides.iter().map(|s| s.as_ref().map(pick)).collect();
            smoothed(&raw, &neighbours, settings.smoothing_rounds)
        };
        let (inner, outer) = (smooth(|s| s.inner), smooth(|s| s.outer));
        let contrast: Vec<f64> = inner.iter().zip(&outer).map(|(a, b)| b - a).collect();
        let contrast_median = quantile(contrast.iter().map(|c| c.abs()), 0.5);
        let noise = quantile(sides.iter().zip(&inner).filter_map(|(s, i)| Some((s.as_ref()?.inner - i).abs())), 0.5);
        if contrast_median <= noise {
            return Err(TrackingError::NoContrast { tag, time_s, contrast: contrast_median, noise });
        }
        let stands_at = |place: usize| Some((sides[place].as_ref()?.middle - inner[place]) / contrast[place]);
        let strong = (0..vertices.len()).filter(|&place| contrast[place].abs() >= 0.5 * contrast_median);
        let fraction = quantile(strong.filter_map(stands_at), 0.5).clamp(0.25, 0.75);
        let gradient_median_per_mm = quantile(seen.iter().map(|s| s.gradient_per_mm), 0.5);
        let intensity_range = (
            quantile(seen.iter().map(|s| s.middle), settings.intensity_quantile),
            quantile(seen.iter().map(|s| s.middle), 1.0 - settings.intensity_quantile),
        );
        let level = inner.iter().zip(&contrast).map(|(i, c)| (i + fraction * c).clamp(intensity_range.0, intensity_range.1)).collect();
        let gradient_threshold_per_mm = settings.gradient_fraction * gradient_median_per_mm;
        Ok(Self {
            tag,
            vertices,
            neighbours,
            inner_span_mm,
            level,
            contrast,
            contrast_median,
            fraction,
            gradient_threshold_per_mm,
            intensity_range,
        })
    }
}

struct Sides {
    inner: f64,
    middle: f64,
    outer: f64,
    gradient_per_mm: f64,
}

fn read_sides(
    vertices: &[usize],
    inner_span_mm: &[[f64; 2]],
    area_mm2: &[Vector3<f64>],
    position_mm: &[Vector3<f64>],
    instant: &ImageInstant,
    outer_span_mm: [f64; 2],
) -> Vec<Option<Sides>> {
    let read = |(&vertex, &inner_span_mm): (&usize, &[f64; 2])| {
        let normal = area_mm2[vertex].try_normalize(0.0)?;
        let inner = side_intensity(instant, &position_mm[vertex], &-normal, inner_span_mm)?;
        let outer = side_intensity(instant, &position_mm[vertex], &normal, outer_span_mm)?;
        let middle = instant.value(&position_mm[vertex])?;
        Some(Sides { inner, middle, outer, gradient_per_mm: instant.gradient_per_mm(&position_mm[vertex])?.norm() })
    };
    vertices.iter().zip(inner_span_mm).map(read).collect()
}

/// Median intensity on one side of a point, between two distances (mm) from it.
pub(super) fn side_intensity(
    instant: &ImageInstant,
    point_mm: &Vector3<f64>,
    direction: &Vector3<f64>,
    [from_mm, to_mm]: [f64; 2],
) -> Option<f64> {
    const READINGS: usize = 5;
    let line = instant.line(point_mm, direction);
    let mut values = [0.0; READINGS];
    for (reading, value) in values.iter_mut().enumerate() {
        let share = reading as f64 / (READINGS - 1) as f64;
        let distance_mm = from_mm + share * (to_mm - from_mm);
        *value = line.value(distance_mm)?;
    }
    values.sort_by(f64::total_cmp);
    Some(values[READINGS / 2])
}

fn neighbours_along(surface: &TaggedSurface, tag: SurfaceTag, vertices: &[usize]) -> Vec<Vec<usize>> {
    let place = |vertex: usize| vertices.partition_point(|&v| v < vertex);
    let mut neighbours = vec![Vec::new(); vertices.len()];
    for [a, b, c] in surface.triangles_with(tag) {
        let [a, b, c] = [a, b, c].map(place);
        for (from, to) in [(a, b), (b, c), (c, a)] {
            neighbours[from].push(to);
            neighbours[to].push(from);
        }
    }
    for list in &mut neighbours {
        list.sort_unstable();
        list.dedup();
    }
    neighbours
}

/// Averages of each vertex with its neighbours, over and over; missing values are filled from neighbours that have one.
fn smoothed(raw: &[Option<f64>], neighbours: &[Vec<usize>], rounds: usize) -> Vec<f64> {
    let weights: Vec<f64> = raw.iter().map(|value| f64::from(u8::from(value.is_some()))).collect();
    let values: Vec<f64> = raw.iter().map(|value| value.unwrap_or(0.0)).collect();
    let everywhere = values.iter().sum::<f64>() / weights.iter().sum::<f64>().max(1.0);
    weighted_average(&values, &weights, neighbours, rounds).into_iter().map(|value| value.unwrap_or(everywhere)).collect()
}

/// Weighted averages along the surface: `rounds` steps of mixing each vertex with its neighbours, of values and weights alike;
/// nothing where no weight has arrived.
pub(super) fn weighted_average(values: &[f64], weights: &[f64], neighbours: &[Vec<usize>], rounds: usize) -> Vec<Option<f64>> {
    let mut mass: Vec<(f64, f64)> = values.iter().zip(weights).map(|(v, w)| (v * w, *w)).collect();
    for _ in 0..rounds {
        mass = mass
            .iter()
            .zip(neighbours)
            .map(|(&own, list)| {
                let share = 1.0 / (list.len() + 1) as f64;
                let (value, weight) = list.iter().fold(own, |sum, &n| (sum.0 + mass[n].0, sum.1 + mass[n].1));
                (value * share, weight * share)
            })
            .collect();
    }
    mass.into_iter().map(|(value, weight)| (weight > 0.0).then(|| value / weight)).collect()
}

/// The value below which a share `probability` of the values lies; zero of nothing.
pub(super) fn quantile(values: impl Iterator<Item = f64>, probability: f64) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    let place = probability * sorted.len().saturating_sub(1) as f64;
    let (low, share) = (place.floor() as usize, place.fract());
    match (sorted.get(low), sorted.get(low + 1)) {
        (Some(a), Some(b)) => a + share * (b - a),
        (Some(a), None) => *a,
        _ => 0.0,
    }
}
