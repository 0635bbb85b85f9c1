//! Deformed tetrahedra → how much of every voxel is blood, wall and background, \[Billet2009\] §6.1.

use std::borrow::Cow;

use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::PhantomError;
use super::error::within;
use super::imaged_heart::ImagedHeart;
use super::scan::{PlaneShape, scan_closed_surface, scan_tetrahedron};
use crate::anatomy::{Anatomy, Ventricle};
use crate::image::{Grid, LabelMap};

/// Code of the left-ventricular cavity in a label map.
pub const LABEL_CAVITY_LV: u8 = 1;
/// Code of the wall in a label map.
pub const LABEL_WALL: u8 = 2;
/// Code of the right-ventricular cavity in a label map.
pub const LABEL_CAVITY_RV: u8 = 3;

/// How a voxel is sampled.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VoxelSampling {
    /// Samples a voxel along i, j, k.
    pub samples_per_voxel: [usize; 3],
    /// What a slice averages over along k, relative to the distance of slices: 1 without gaps, less with gaps, more if slices overlap.
    pub thickness_share: f64,
}

impl Default for VoxelSampling {
    fn default() -> Self {
        Self { samples_per_voxel: [3, 3, 3], thickness_share: 1.0 }
    }
}

impl VoxelSampling {
    /// What lies at the centre of every voxel: masks, which are drawn on the middle of a slice. The largest share of a voxel would favour blood over a
    /// thin wall, and over half of a slice whose surfaces slant.
    pub const CENTRES: Self = Self { samples_per_voxel: [1, 1, 1], thickness_share: 1.0 };

    pub(super) fn check(&self, grid: &Grid) -> Result<(), PhantomError> {
        within("the slice thickness relative to the slice distance", self.thickness_share, [1e-6, 100.0], "lie between 1e-6 and 100")?;
        let samples: usize = self.samples_per_voxel.iter().product();
        let plane = grid.shape()[0].saturating_mul(grid.shape()[1]).saturating_mul(samples);
        if plane == 0 || plane > 1 << 28 || grid.voxel_count() > 1 << 30 {
            return Err(PhantomError::ImageSize { shape: grid.shape(), samples_per_voxel: self.samples_per_voxel });
        }
        Ok(())
    }

    pub(super) fn plane(&self, grid: &Grid) -> PlaneShape {
        let [ni, nj, _] = grid.shape();
        PlaneShape { width: ni * self.samples_per_voxel[0], height: nj * self.samples_per_voxel[1] }
    }

    /// World positions → sample coordinates: x and y count samples, z counts slices.
    pub(super) fn sample_positions(&self, grid: &Grid, positions_mm: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
        let [ni, nj, _] = self.samples_per_voxel.map(|n| n as f64);
        let place = |voxel: Vector3<f64>| Vector3::new((voxel.x + 0.5) * ni - 0.5, (voxel.y + 0.5) * nj - 0.5, voxel.z);
        positions_mm.iter().map(|position| place(grid.to_voxel(position))).collect()
    }

    /// The sample coordinates of slice `k`, which shows everything displaced by its shift (mm along i and j).
    pub(super) fn displaced<'p>(&self, grid: &Grid, points: &'p [Vector3<f64>], shift_mm: Vector2<f64>) -> Cow<'p, [Vector3<f64>]> {
        if shift_mm == Vector2::zeros() {
            return Cow::Borrowed(points);
        }
        let per_mm = |axis: usize| self.samples_per_voxel[axis] as f64 / grid.spacing_mm()[axis];
        let shift = Vector3::new(shift_mm.x * per_mm(0), shift_mm.y * per_mm(1), 0.0);
        Cow::Owned(points.iter().map(|point| point + shift).collect())
    }

    /// Heights (in slices) of the sample planes of slice `k`.
    pub(super) fn heights(&self, k: usize) -> impl Iterator<Item = f64> {
        let (count, share) = (self.samples_per_voxel[2], self.thickness_share);
        (0..count).map(move |plane| k as f64 + share * ((plane as f64 + 0.5) / count as f64 - 0.5))
    }

    /// The voxel of a slice that a sample of its plane belongs to.
    pub(super) fn voxel_in_slice(&self, sample: usize, plane: PlaneShape) -> usize {
        let [ni, nj, _] = self.samples_per_voxel;
        (sample % plane.width) / ni + (sample / plane.width) / nj * (plane.width / ni)
    }
}

/// The share (0 to 1) of every voxel, i fastest, that is blood of each cavity, and wall; the rest is background.
#[derive(Debug, Clone, PartialEq)]
pub struct TissueShares {
    grid: Grid,
    cavities: Vec<(Ventricle, Vec<f32>)>,
    wall: Vec<f32>,
}

impl TissueShares {
    /// Where the voxels lie.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Share of blood below the lid of each cavity, left first.
    pub fn cavities(&self) -> &[(Ventricle, Vec<f32>)] {
        &self.cavities
    }

    /// Share of wall.
    pub fn wall(&self) -> &[f32] {
        &self.wall
    }

    /// Volume of one cavity, mm³.
    pub fn cavity_volume_mm3(&self, cavity: usize) -> f64 {
        self.cavities.get(cavity).map_or(0.0, |(_, share)| sum(share)) * self.grid.voxel_volume_mm3()
    }

    /// Volume of the wall, mm³.
    pub fn wall_volume_mm3(&self) -> f64 {
        sum(&self.wall) * self.grid.voxel_volume_mm3()
    }

    /// Every voxel by its largest share: [`LABEL_CAVITY_LV`], [`LABEL_WALL`], [`LABEL_CAVITY_RV`] or 0; the first of equals in this order.
    ///
    /// # Errors
    /// Never for shares made by [`rasterise`].
    pub fn to_label_map(&self) -> Result<LabelMap, PhantomError> {
        let label = |voxel: usize| {
            let blood = self.cavities.iter().map(|(ventricle, share)| (label_of(*ventricle), share[voxel]));
            let shares: Vec<(u8, f32)> = blood.chain([(LABEL_WALL, self.wall[voxel])]).collect();
            let background = 1.0 - shares.iter().map(|&(_, share)| share).sum::<f32>();
            let largest = |best: (u8, f32), next: (u8, f32)| if next.1 > best.1 { next } else { best };
            let (label, share) = shares.into_iter().fold((0, 0.0), largest);
            if share >= background { label } else { 0 }
        };
        let labels = (0..self.wall.len()).map(label).collect();
        Ok(LabelMap::new(self.grid.clone(), labels)?)
    }
}

fn label_of(ventricle: Ventricle) -> u8 {
    match ventricle {
        Ventricle::Left => LABEL_CAVITY_LV,
        Ventricle::Right => LABEL_CAVITY_RV,
    }
}

fn sum(shares: &[f32]) -> f64 {
    shares.iter().map(|&share| f64::from(share)).sum()
}

/// Rasterises the heart at `position_mm` (one a mesh vertex): blood is what an endocardium and its lid enclose and no tetrahedron covers.
/// Slices are independent of each other, so the result does not depend on the number of threads.
///
/// # Errors
/// [`PhantomError`] if positions do not fit the mesh or are not finite, or the sampling is out of range.
pub fn rasterise(
    anatomy: &Anatomy,
    position_mm: &[Vector3<f64>],
    grid: &Grid,
    sampling: &VoxelSampling,
) -> Result<TissueShares, PhantomError> {
    rasterise_displaced(anatomy, position_mm, grid, sampling, &[])
}

/// As [`rasterise`], with every slice displaced by its own shift (mm along i and j; slices without one lie right).
pub(super) fn rasterise_displaced(
    anatomy: &Anatomy,
    position_mm: &[Vector3<f64>],
    grid: &Grid,
    sampling: &VoxelSampling,
    slice_shifts_mm: &[Vector2<f64>],
) -> Result<TissueShares, PhantomError> {
    sampling.check(grid)?;
    check_positions(anatomy, 0, position_mm)?;
    let heart = ImagedHeart::new(anatomy, 0.0);
    let points = sampling.sample_positions(grid, &heart.positions_mm(position_mm));
    let slice = |k: usize| {
        let shift_mm = slice_shifts_mm.get(k).copied().unwrap_or_default();
        count_slice(&heart, &sampling.displaced(grid, &points, shift_mm), grid, sampling, k)
    };
    let slices: Vec<SliceCounts> = (0..grid.shape()[2]).into_par_iter().map(slice).collect();
    let cavities = anatomy.cavities.iter().enumerate();
    let gather = |part: usize| slices.iter().flat_map(|slice| slice.shares[part].iter().copied()).collect();
    let cavities = cavities.map(|(cavity, (ventricle, _))| (*ventricle, gather(1 + cavity))).collect();
    Ok(TissueShares { grid: grid.clone(), cavities, wall: gather(0) })
}

/// Checks the positions of a frame against the mesh.
pub(super) fn check_positions(anatomy: &Anatomy, frame: usize, position_mm: &[Vector3<f64>]) -> Result<(), PhantomError> {
    let (position_count, vertex_count) = (position_mm.len(), anatomy.mesh.vertex_count());
    if position_count != vertex_count {
        return Err(PhantomError::PositionCount { frame, position_count, vertex_count });
    }
    match position_mm.iter().position(|p| !p.iter().all(|x| x.is_finite())) {
        Some(vertex) => Err(PhantomError::NonFinitePosition { frame, vertex }),
        None => Ok(()),
    }
}

/// Shares of one slice: of the wall, then of each cavity.
struct SliceCounts {
    shares: Vec<Vec<f32>>,
}

fn count_slice(heart: &ImagedHeart, points: &[Vector3<f64>], grid: &Grid, sampling: &VoxelSampling, k: usize) -> SliceCounts {
    let plane = sampling.plane(grid);
    let voxel_count = grid.shape()[0] * grid.shape()[1];
    let mut shares = vec![vec![0.0_f32; voxel_count]; 1 + heart.cavities.len()];
    let one = 1.0 / sampling.samples_per_voxel.iter().product::<usize>() as f32;
    let mut parts = vec![u8::MAX; plane.sample_count()];
    for z in sampling.heights(k) {
        parts.fill(u8::MAX);
        paint_parts(heart, points, plane, z, &mut parts);
        for (sample, &part) in parts.iter().enumerate().filter(|&(_, &part)| part != u8::MAX) {
            shares[part as usize][sampling.voxel_in_slice(sample, plane)] += one;
        }
    }
    SliceCounts { shares }
}

/// Writes 0 where the wall is and 1 + cavity where its blood is; leaves the rest.
pub(super) fn paint_parts(heart: &ImagedHeart, points: &[Vector3<f64>], plane: PlaneShape, z: f64, parts: &mut [u8]) {
    for (cavity, triangles) in heart.cavities.iter().enumerate() {
        scan_closed_surface(points, triangles, z, plane, &mut |sample| parts[sample] = 1 + cavity as u8);
    }
    scan_wall(&heart.wall, points, plane, z, &mut |sample, _, _| parts[sample] = 0);
}

/// Scans those tetrahedra that the plane cuts; `paint` gets sample, tetrahedron and barycentric coordinates.
pub(super) fn scan_wall(
    tetrahedra: &[[usize; 4]],
    points: &[Vector3<f64>],
    plane: PlaneShape,
    z: f64,
    paint: &mut impl FnMut(usize, &[usize; 4], &[f64; 4]),
) {
    for vertices in tetrahedra {
        let is_above = vertices.map(|v| points[v].z > z);
        let is_below = vertices.map(|v| points[v].z < z);
        if is_above == [true; 4] || is_below == [true; 4] {
            continue;
        }
        let corners = vertices.map(|v| points[v]);
        scan_tetrahedron(&corners, z, plane, &mut |sample, coordinates| paint(sample, vertices, coordinates));
    }
}
