//! What the numbers of a label map mean, and how fields are made from them.

use std::ops::Range;

use nalgebra::{Matrix3, Vector3};

use crate::image::{ImageError, LabelMap};

/// A plane through `point_mm` with a unit `normal`.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Plane {
    /// A point of the plane, world mm.
    pub point_mm: Vector3<f64>,
    /// Unit normal, world axes.
    pub normal: Vector3<f64>,
}

impl Plane {
    /// The plane nearest to at least three points (least squares of the distances), through their mean; `None` where they are fewer or lie on a line.
    ///
    /// ```
    /// use cardiotwin::image::Plane;
    /// use nalgebra::Vector3;
    /// let ring_mm = [[1.0, 0.0, 5.1], [-1.0, 0.0, 4.9], [0.0, 1.0, 5.0], [0.0, -1.0, 5.0]].map(Vector3::from);
    /// let plane = Plane::through(&ring_mm).expect("four points not on a line");
    /// assert!((plane.point_mm.z - 5.0).abs() < 1e-12);
    /// assert!((plane.normal.x / plane.normal.z + 0.1).abs() < 1e-12);
    /// ```
    pub fn through(points_mm: &[Vector3<f64>]) -> Option<Self> {
        /// Points whose spread across their line is a smaller share of that along it lie on it.
        const ON_A_LINE: f64 = 1e-3;
        if points_mm.len() < 3 {
            return None;
        }
        let point_mm = points_mm.iter().sum::<Vector3<f64>>() / points_mm.len() as f64;
        let scatter: Matrix3<f64> = points_mm.iter().map(|p| (p - point_mm) * (p - point_mm).transpose()).sum();
        let eigen = scatter.symmetric_eigen();
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigen.eigenvalues[a].total_cmp(&eigen.eigenvalues[b]));
        let [across, along] = [eigen.eigenvalues[order[1]], eigen.eigenvalues[order[2]]];
        (across > ON_A_LINE.powi(2) * along).then(|| Self { point_mm, normal: eigen.eigenvectors.column(order[0]).into() })
    }

    /// Signed distance, mm: positive on the side to which the normal points.
    pub fn signed_distance_mm(&self, position_mm: &Vector3<f64>) -> f64 {
        self.normal.dot(&(position_mm - self.point_mm))
    }
}

/// The codes of a heart in a label map: all different and not 0, but that both walls may share one.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct HeartCodes {
    /// Blood of the left ventricle.
    pub cavity_lv: u8,
    /// Wall of the left ventricle, or of both.
    pub wall_lv: u8,
    /// Blood of the right ventricle; `None` leaves it out.
    pub cavity_rv: Option<u8>,
    /// Wall of the right ventricle where it has its own code.
    pub wall_rv: Option<u8>,
}

impl HeartCodes {
    /// A left ventricle alone.
    pub fn left(cavity_lv: u8, wall_lv: u8) -> Self {
        Self { cavity_lv, wall_lv, cavity_rv: None, wall_rv: None }
    }

    /// The codes of blood.
    pub fn cavities(&self) -> Vec<u8> {
        [Some(self.cavity_lv), self.cavity_rv].into_iter().flatten().collect()
    }

    /// The codes of wall.
    pub fn walls(&self) -> Vec<u8> {
        [Some(self.wall_lv), self.wall_rv].into_iter().flatten().collect()
    }

    /// All codes in use.
    pub fn all(&self) -> Vec<u8> {
        [self.cavities(), self.walls()].concat()
    }
}

/// Which end of the slices is the apex.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum ApexEnd {
    /// The end with the smaller cavity.
    #[default]
    Detect,
    /// The labelled slice with the lowest index.
    FirstSlice,
    /// The labelled slice with the highest index.
    LastSlice,
}

/// Where the heart is cut at the base.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub enum BaseCut {
    /// Parallel to the slices, half a slice beyond the mid-plane of the most basal labelled slice: the labels' whole volume is kept.
    #[default]
    OuterFace,
    /// Parallel to the slices, in the mid-plane of the most basal labelled slice: nothing is extrapolated.
    MidSlice,
    /// By a plane of one's own, such as that of the valves; its normal may point either way.
    Plane(Plane),
}

/// How fields are made from labels.
#[derive(Debug, Clone, PartialEq)]
pub struct FieldOptions {
    /// Spacing of the fields' isotropic grid, mm; `None` is the finer in-plane spacing of the labels.
    pub spacing_mm: Option<f64>,
    /// Slices (index k) that are looked at; `None` is all of them.
    pub slices: Option<Range<usize>>,
    /// Which end is the apex.
    pub apex: ApexEnd,
    /// Where the base is cut.
    pub base: BaseCut,
    /// The wall is nowhere thinner, mm: where it would be, the cavity gives way.
    pub wall_thickness_min_mm: f64,
    /// Thickness of the wall that is grown around a left cavity without one, mm; with `None` its slices do not count.
    pub wall_thickness_lv_mm: Option<f64>,
    /// Thickness of the wall that is grown around a right cavity without one, mm.
    pub wall_thickness_rv_mm: f64,
    /// By how much the grid surpasses the heart on every side, mm.
    pub margin_mm: f64,
}

impl Default for FieldOptions {
    fn default() -> Self {
        Self {
            spacing_mm: None,
            slices: None,
            apex: ApexEnd::default(),
            base: BaseCut::default(),
            wall_thickness_min_mm: 2.0,
            wall_thickness_lv_mm: None,
            wall_thickness_rv_mm: 3.0,
            margin_mm: 8.0,
        }
    }
}

impl FieldOptions {
    /// By how much the grid surpasses the labels on every side, mm.
    pub(super) fn reach_mm(&self, codes: &HeartCodes) -> f64 {
        let right_mm = codes.cavity_rv.map_or(0.0, |_| self.wall_thickness_rv_mm);
        self.margin_mm + right_mm.max(self.wall_thickness_lv_mm.unwrap_or(0.0))
    }

    /// Refuses codes and options that make no sense for these labels.
    pub(super) fn check(&self, labels: &LabelMap, codes: &HeartCodes) -> Result<(), ImageError> {
        let unusable = |reason: String| Err(ImageError::UnusableMask { reason });
        let all = codes.all();
        if all.contains(&0) || (1..all.len()).any(|n| all[..n].contains(&all[n])) {
            return unusable(format!("the labels {all:?} (cavities, then walls) must differ from each other and from 0"));
        }
        let spacing_mm = labels.grid().spacing_mm();
        let step_mm = self.spacing_mm.unwrap_or(spacing_mm.x.min(spacing_mm.y));
        if !(step_mm > 0.05 && step_mm < 20.0) {
            return unusable(format!("a grid spacing of {step_mm} mm is not usable"));
        }
        let lengths = [self.margin_mm, self.wall_thickness_min_mm, self.wall_thickness_rv_mm];
        if !lengths.iter().chain(&self.wall_thickness_lv_mm).all(|mm| (0.0..=100.0).contains(mm)) || self.margin_mm < 2.0 * step_mm {
            return unusable(format!(
                "margin {} mm, least wall {} mm, RV wall {} mm and LV wall {} mm must be 0 to 100 mm, the margin at least two grid steps ({} mm)",
                self.margin_mm,
                self.wall_thickness_min_mm,
                self.wall_thickness_rv_mm,
                self.wall_thickness_lv_mm.unwrap_or(0.0),
                2.0 * step_mm
            ));
        }
        if let BaseCut::Plane(plane) = &self.base
            && !(plane.point_mm.iter().all(|x| x.is_finite()) && (plane.normal.norm() - 1.0).abs() < 1e-6)
        {
            return unusable("the normal of the base plane must be a unit vector, and its point finite".to_string());
        }
        Ok(())
    }
}
