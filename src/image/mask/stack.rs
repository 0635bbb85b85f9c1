//! A shape between and beyond its slices: in-plane signed distances interpolated along the slice axis, with a rounded cap at the apex.
//!
//! Between slices the distances d_k(x) are joined by cubic Hermite curves with centred tangents (shape-aware interpolation: the zero
//! level moves, grey values do not fade). Beyond the most apical slice the cross-section A is continued by its last slope, as in a
//! paraboloid: A(s) = A₀ (1 − s/H) with H = A₀ / (dA/ds), which closes in a rounded tip H below the slice's mid-plane. With the inscribed
//! radius r₀ = −min d₀ and ρ = d₀ + r₀,
//!
//! $$ \varphi(x, s) = \frac{\rho(x)^2 - r_0^2\,(1 - s/H)}{\rho(x) + r_0}, $$
//!
//! which is d₀ at s = 0 and whose zero level is the cap.

use nalgebra::Vector2;

use super::outline::SliceField;

/// How fast the outline may widen or narrow beyond the most basal slice, mm per mm.
const BASAL_SLOPE_MAX: f64 = 0.5;

/// The tangent at the apical slice is at most this many times the secant, so that the cubic does not overshoot.
const APICAL_TANGENT_RATIO_MAX: f64 = 2.5;

/// The slices of one shape from apex to base.
#[derive(Debug)]
pub(super) struct ShapeStack {
    heights_mm: Vec<f64>,
    fields: Vec<SliceField>,
    cap_mm: f64,
    inscribed_radius_mm: f64,
    /// Added to the tangent of the most apical slice so that the outline runs smoothly into the cap, mm per mm.
    apical_tangent_offset: f64,
    /// Beyond this height the shape is continued unchanged.
    base_height_mm: f64,
}

/// The length of a cap and why it is not the one the slices' areas suggest.
pub(super) struct CapLength {
    pub(super) length_mm: f64,
    pub(super) limited: Option<&'static str>,
}

impl CapLength {
    /// From the areas (mm²) of the two most apical slices, `gap_mm` apart; at most `longest_mm`.
    pub(super) fn from_areas(areas_mm2: &[f64], gap_mm: f64, longest_mm: f64) -> Self {
        const SHORTEST: f64 = 0.1;
        let slope = (areas_mm2[1] - areas_mm2[0]) / gap_mm;
        let length_mm = areas_mm2[0] / slope;
        if slope <= 0.0 || length_mm > longest_mm {
            Self { length_mm: longest_mm, limited: Some("tapers too little to close where the slices end") }
        } else if length_mm < SHORTEST * longest_mm {
            Self { length_mm: SHORTEST * longest_mm, limited: Some("tapers very fast") }
        } else {
            Self { length_mm, limited: None }
        }
    }
}

impl ShapeStack {
    /// `heights_mm` ascend from the apical slice; `areas_mm2` are the slices' areas; two slices or more.
    pub(super) fn new(heights_mm: Vec<f64>, fields: Vec<SliceField>, areas_mm2: &[f64], cap_mm: f64, base_height_mm: f64) -> Self {
        let inscribed_radius_mm = (-fields[0].min()).max(1e-6);
        let radius_mm = |area: f64| (area / std::f64::consts::PI).sqrt();
        let secant = (radius_mm(areas_mm2[1]) - radius_mm(areas_mm2[0])) / (heights_mm[1] - heights_mm[0]);
        let widening = (radius_mm(areas_mm2[0]) / (2.0 * cap_mm)).min(APICAL_TANGENT_RATIO_MAX * secant.abs());
        let apical_tangent_offset = secant - widening;
        Self { heights_mm, fields, cap_mm, inscribed_radius_mm, apical_tangent_offset, base_height_mm }
    }

    /// Height of the tip of the cap, mm.
    pub(super) fn tip_height_mm(&self) -> f64 {
        self.heights_mm[0] - self.cap_mm
    }

    /// The level-set function at continuous pixel coordinates and a height, mm; negative inside.
    pub(super) fn value_mm(&self, pixel: Vector2<f64>, height_mm: f64) -> f64 {
        let last = self.heights_mm.len() - 1;
        if height_mm <= self.heights_mm[0] {
            self.cap_value_mm(pixel, self.heights_mm[0] - height_mm)
        } else if height_mm >= self.heights_mm[last] {
            let (top, below) = (self.fields[last].sample(pixel), self.fields[last - 1].sample(pixel));
            let slope = (top - below) / (self.heights_mm[last] - self.heights_mm[last - 1]);
            let beyond_mm = height_mm.min(self.base_height_mm) - self.heights_mm[last];
            top + slope.clamp(-BASAL_SLOPE_MAX, BASAL_SLOPE_MAX) * beyond_mm.max(0.0)
        } else {
            self.between_value_mm(pixel, height_mm)
        }
    }

    fn cap_value_mm(&self, pixel: Vector2<f64>, below_mm: f64) -> f64 {
        let radius = self.inscribed_radius_mm;
        let rho = (self.fields[0].sample(pixel) + radius).max(0.0);
        (rho * rho - radius * radius * (1.0 - below_mm / self.cap_mm)) / (rho + radius)
    }

    fn between_value_mm(&self, pixel: Vector2<f64>, height_mm: f64) -> f64 {
        let upper = self.heights_mm.partition_point(|&h| h <= height_mm).min(self.heights_mm.len() - 1);
        let lower = upper - 1;
        let gap_mm = self.heights_mm[upper] - self.heights_mm[lower];
        let t = (height_mm - self.heights_mm[lower]) / gap_mm;
        let (start, end) = (self.fields[lower].sample(pixel), self.fields[upper].sample(pixel));
        let (start_slope, end_slope) = (self.tangent(pixel, lower, start, end), self.tangent(pixel, upper, start, end));
        let (t2, t3) = (t * t, t * t * t);
        (2.0 * t3 - 3.0 * t2 + 1.0) * start
            + (t3 - 2.0 * t2 + t) * gap_mm * start_slope
            + (3.0 * t2 - 2.0 * t3) * end
            + (t3 - t2) * gap_mm * end_slope
    }

    /// Slope along the axis at slice `at`, one end of the interval whose values are `start` and `end`.
    fn tangent(&self, pixel: Vector2<f64>, at: usize, start: f64, end: f64) -> f64 {
        let last = self.heights_mm.len() - 1;
        if at == 0 {
            (end - start) / (self.heights_mm[1] - self.heights_mm[0]) + self.apical_tangent_offset
        } else if at == last {
            (end - start) / (self.heights_mm[last] - self.heights_mm[last - 1])
        } else {
            let (below, above) = (self.fields[at - 1].sample(pixel), self.fields[at + 1].sample(pixel));
            (above - below) / (self.heights_mm[at + 1] - self.heights_mm[at - 1])
        }
    }
}
