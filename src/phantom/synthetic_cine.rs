//! A cine sequence of a heart whose motion is known, with the truth beside it, \[Billet2009\] §6.1.
//!
//! Wall, blood and background have intensities as in balanced steady-state cine: bright blood, grey muscle, dark surroundings. The wall
//! carries a texture that belongs to the material (it is evaluated where the point was at rest), the surroundings carry a still one; every
//! voxel averages its samples (partial volume, thick slices); bias and Rician noise come last.

use nalgebra::{Vector2, Vector3};
use rayon::prelude::*;

use super::PhantomError;
use super::error::within;
use super::imaged_heart::ImagedHeart;
use super::noise::{BiasField, add_rician_noise};
use super::random_field::RandomField;
use super::rasterise::{VoxelSampling, check_positions, rasterise_displaced, scan_wall};
use super::scan::scan_closed_surface;
use crate::anatomy::Anatomy;
use crate::image::{CineSequence, Grid, LabelMap, Volume};
use crate::units::ml_from_mm3;

/// What the scanner sees and how well. Intensities are those of the noise-free image.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticCineSettings {
    /// How a voxel averages.
    pub sampling: VoxelSampling,
    /// Intensity of blood.
    pub blood: f64,
    /// Mean intensity of the wall.
    pub wall: f64,
    /// Mean intensity of the surroundings.
    pub background: f64,
    /// Deviation of the texture of the wall, relative to its intensity.
    pub wall_texture: f64,
    /// Deviation of the texture of the surroundings, relative to their intensity.
    pub background_texture: f64,
    /// Correlation length of the texture of the wall, mm.
    pub wall_texture_length_mm: f64,
    /// Correlation length of the texture of the surroundings, mm.
    pub background_texture_length_mm: f64,
    /// How far wall and blood go on beyond the base, mm; 0 leaves a hard cut.
    pub continuation_mm: f64,
    /// Deviation of the noise in each of the two channels.
    pub noise: f64,
    /// Amplitude of the logarithm of the bias field; 0 for none.
    pub bias: f64,
    /// By how much every slice (index k) shows everything displaced, mm along i and j, as breath-holds that differ do; the slices beyond the list
    /// lie right.
    pub slice_shifts_mm: Vec<Vector2<f64>>,
    /// Seed of textures and noise.
    pub seed: u64,
}

impl Default for SyntheticCineSettings {
    fn default() -> Self {
        Self {
            sampling: VoxelSampling { samples_per_voxel: [2, 2, 2], thickness_share: 1.0 },
            blood: 200.0,
            wall: 90.0,
            background: 40.0,
            wall_texture: 0.12,
            background_texture: 0.35,
            wall_texture_length_mm: 3.0,
            background_texture_length_mm: 6.0,
            continuation_mm: 40.0,
            noise: 6.0,
            bias: 0.1,
            slice_shifts_mm: Vec::new(),
            seed: 1,
        }
    }
}

/// A cine sequence and what it was made of.
#[derive(Debug, Clone, PartialEq)]
pub struct SyntheticCine {
    /// The images.
    pub cine: CineSequence,
    /// The tissue at the centre of every voxel, one map a frame, displaced as the slices are: codes of [`super::TissueShares::to_label_map`].
    pub labels: Vec<LabelMap>,
    /// True volume of each cavity (left first) in every frame, mL, from the mesh.
    pub volumes_ml: Vec<Vec<f64>>,
    /// The same summed over the shares of blood in the voxels: what the sampling of the voxels makes of it.
    pub voxel_volumes_ml: Vec<Vec<f64>>,
}

/// Images the heart at the positions of every frame (one a mesh vertex, mm). The same seed gives the same bits on any number of threads.
///
/// # Errors
/// [`PhantomError`] if a setting is out of range, positions do not fit the mesh, or the times do not make a cine sequence.
pub fn synthetic_cine(
    anatomy: &Anatomy,
    frames_mm: &[Vec<Vector3<f64>>],
    times_s: &[f64],
    period_s: f64,
    grid: &Grid,
    settings: &SyntheticCineSettings,
) -> Result<SyntheticCine, PhantomError> {
    settings.check(grid)?;
    for (frame, positions) in frames_mm.iter().enumerate() {
        check_positions(anatomy, frame, positions)?;
    }
    let scene = Scene::new(anatomy, grid, settings);
    let images = frames_mm.iter().enumerate().map(|(frame, positions)| scene.image(frame, positions));
    let images = images.collect::<Result<Vec<_>, _>>()?;
    let (sampling, shifts_mm) = (&settings.sampling, &settings.slice_shifts_mm);
    let (mut labels, mut voxel_volumes_ml) = (Vec::new(), Vec::new());
    for positions in frames_mm {
        let shares = rasterise_displaced(anatomy, positions, grid, sampling, shifts_mm)?;
        voxel_volumes_ml.push((0..anatomy.cavities.len()).map(|cavity| ml_from_mm3(shares.cavity_volume_mm3(cavity))).collect());
        labels.push(rasterise_displaced(anatomy, positions, grid, &VoxelSampling::CENTRES, shifts_mm)?.to_label_map()?);
    }
    let volumes = |positions: &Vec<Vector3<f64>>| {
        anatomy.cavities.iter().map(|(_, cavity)| ml_from_mm3(cavity.volume_mm3(positions))).collect::<Vec<f64>>()
    };
    Ok(SyntheticCine {
        labels,
        voxel_volumes_ml,
        volumes_ml: frames_mm.iter().map(volumes).collect(),
        cine: CineSequence::new(images, times_s.to_vec(), period_s)?,
    })
}

impl SyntheticCineSettings {
    fn shift_mm(&self, slice: usize) -> Vector2<f64> {
        self.slice_shifts_mm.get(slice).copied().unwrap_or_default()
    }

    fn check(&self, grid: &Grid) -> Result<(), PhantomError> {
        self.sampling.check(grid)?;
        let amounts = [
            ("the intensity of blood", self.blood),
            ("the intensity of the wall", self.wall),
            ("the intensity of the background", self.background),
            ("the noise", self.noise),
            ("the continuation beyond the base in mm", self.continuation_mm),
        ];
        for (name, value) in amounts {
            within(name, value, [0.0, 1e6], "lie between 0 and 1e6")?;
        }
        for (name, value) in [("the texture of the wall", self.wall_texture), ("the texture of the background", self.background_texture)] {
            within(name, value, [0.0, 10.0], "lie between 0 and 10")?;
        }
        let lengths = [
            ("the texture length of the wall in mm", self.wall_texture_length_mm),
            ("the texture length of the background in mm", self.background_texture_length_mm),
        ];
        for (name, value) in lengths {
            within(name, value, [0.2, 1e3], "lie between 0.2 and 1000 mm")?;
        }
        within("the bias", self.bias, [0.0, 3.0], "lie between 0 and 3")?;
        for shift_mm in self.slice_shifts_mm.iter().flat_map(|shift| shift.iter()) {
            within("a slice's shift in mm", *shift_mm, [-100.0, 100.0], "lie between -100 and 100 mm")?;
        }
        Ok(())
    }
}

/// What all frames share.
struct Scene<'a> {
    heart: ImagedHeart,
    grid: &'a Grid,
    settings: &'a SyntheticCineSettings,
    wall_texture: RandomField,
    /// Intensity of the surroundings in every voxel.
    background: Vec<f32>,
    bias: BiasField,
}

impl<'a> Scene<'a> {
    fn new(anatomy: &Anatomy, grid: &'a Grid, settings: &'a SyntheticCineSettings) -> Self {
        let heart = ImagedHeart::new(anatomy, settings.continuation_mm);
        let wall_texture = RandomField::new(bounds(heart.rest_mm.iter().copied()), settings.wall_texture_length_mm, settings.seed);
        let background = background(grid, settings);
        Self { heart, grid, settings, wall_texture, background, bias: BiasField::new(grid, settings.bias) }
    }

    fn image(&self, frame: usize, position_mm: &[Vector3<f64>]) -> Result<Volume, PhantomError> {
        let points = self.settings.sampling.sample_positions(self.grid, &self.heart.positions_mm(position_mm));
        let slices: Vec<Vec<f32>> = (0..self.grid.shape()[2]).into_par_iter().map(|k| self.slice(frame, k, &points)).collect();
        Ok(Volume::new(self.grid.clone(), slices.concat())?)
    }

    fn slice(&self, frame: usize, k: usize, points: &[Vector3<f64>]) -> Vec<f32> {
        let [ni, nj, nk] = self.grid.shape();
        let sampling = &self.settings.sampling;
        let plane = sampling.plane(self.grid);
        let one = 1.0 / sampling.samples_per_voxel.iter().product::<usize>() as f32;
        let mut values = self.background[k * ni * nj..(k + 1) * ni * nj].to_vec();
        let surroundings = values.clone();
        let mut samples = vec![f32::NAN; plane.sample_count()];
        let points = sampling.displaced(self.grid, points, self.settings.shift_mm(k));
        for z in sampling.heights(k) {
            samples.fill(f32::NAN);
            self.paint(&points, z, &mut samples);
            for (sample, &intensity) in samples.iter().enumerate().filter(|(_, intensity)| !intensity.is_nan()) {
                let voxel = sampling.voxel_in_slice(sample, plane);
                values[voxel] += one * (intensity - surroundings[voxel]);
            }
        }
        for (voxel, value) in values.iter_mut().enumerate() {
            *value *= self.bias.factor([voxel % ni, voxel / ni, k]) as f32;
        }
        add_rician_noise(&mut values, self.settings.noise, self.settings.seed, (1 + frame * nk + k) as u64);
        values
    }

    /// Intensities of the samples of a plane; NaN where there is no heart.
    fn paint(&self, points: &[Vector3<f64>], z: f64, samples: &mut [f32]) {
        let plane = self.settings.sampling.plane(self.grid);
        for pool in &self.heart.pools {
            scan_closed_surface(points, pool, z, plane, &mut |sample| samples[sample] = self.settings.blood as f32);
        }
        // The model's wall is painted last, so that it is never hidden by its continuation.
        for tetrahedra in [&self.heart.continuation, &self.heart.wall] {
            scan_wall(tetrahedra, points, plane, z, &mut |sample, vertices, coordinates| {
                let rest = vertices.iter().zip(coordinates).map(|(&v, &share)| self.heart.rest_mm[v] * share).sum();
                samples[sample] = self.wall_intensity(&rest) as f32;
            });
        }
    }

    fn wall_intensity(&self, rest_mm: &Vector3<f64>) -> f64 {
        let settings = self.settings;
        let texture = if settings.wall_texture > 0.0 { self.wall_texture.at(rest_mm) } else { 0.0 };
        (settings.wall * (1.0 + settings.wall_texture * texture)).max(0.0)
    }
}

/// The surroundings: still, textured, never negative.
fn background(grid: &Grid, settings: &SyntheticCineSettings) -> Vec<f32> {
    let [ni, nj, nk] = grid.shape().map(|n| n.saturating_sub(1) as f64);
    let corners =
        (0..8).map(|c| grid.to_world_mm(&Vector3::new(f64::from(c & 1) * ni, f64::from(c >> 1 & 1) * nj, f64::from(c >> 2) * nk)));
    let seed = settings.seed ^ 0x5DEE_CE66_D1CE_4E5B;
    let field = RandomField::new(bounds(corners), settings.background_texture_length_mm, seed);
    let value = |voxel: usize| {
        let [i, j, k] = grid.voxel_of(voxel);
        let shift = settings.shift_mm(k).component_div(&grid.spacing_mm().xy());
        let place = Vector3::new(i as f64 - shift.x, j as f64 - shift.y, k as f64);
        (settings.background * (1.0 + settings.background_texture * field.at(&grid.to_world_mm(&place)))).max(0.0) as f32
    };
    (0..grid.voxel_count()).into_par_iter().map(value).collect()
}

fn bounds(points: impl Iterator<Item = Vector3<f64>>) -> [Vector3<f64>; 2] {
    let start = [Vector3::repeat(f64::INFINITY), Vector3::repeat(f64::NEG_INFINITY)];
    points.fold(start, |[low, high], p| [low.inf(&p), high.sup(&p)])
}
