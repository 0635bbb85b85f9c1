//! The volume of a cavity over one beat: end-diastole, end-systole, diastasis, and a smooth curve that ejects once and fills once.
//!
//! Smoothing is a quadratic program in the volumes v at the measured instants,
//!
//! $$ \min_v \sum_i (v_i - y_i)^2 + \lambda \sum_i (\Delta^2 v)_i^2 \quad\text{s.t.}\quad v \text{ falls from ED to ES and rises from ES to ED}, $$
//!
//! with Δ² the periodic second difference (in units of the mean time step, for uneven steps too), so that ED is the one maximum
//! and ES the one minimum.

use nalgebra::{DMatrix, DVector};

use super::{ImageError, LabelMap};
use crate::numerics::{QpError, QuadraticProgram};

/// Volumes of one cavity at instants of one beat, periodic.
#[derive(Debug, Clone, PartialEq)]
pub struct VolumeCurve {
    times_s: Vec<f64>,
    volumes_ml: Vec<f64>,
    period_s: f64,
}

/// A curve that ejects once and fills once.
struct NearestBeat {
    end_diastole: usize,
    end_systole: usize,
    volumes_ml: Vec<f64>,
}

/// One instant of a curve.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CurvePoint {
    /// Which of the curve's instants.
    pub frame: usize,
    /// Its time, s.
    pub time_s: f64,
    /// Its volume, mL.
    pub volume_ml: f64,
}

/// The instant of diastasis, when filling pauses before the atrial kick.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MidDiastole {
    /// The instant.
    pub point: CurvePoint,
    /// Whether the curve shows a pause between two waves of filling; if not, the instant was placed by its usual time.
    pub pause_seen: bool,
}

/// Share of the filling time after which diastasis is expected where the curve does not show it.
const USUAL_DIASTASIS: f64 = 0.7;

/// Diastasis is sought in this part of the filling time.
const DIASTASIS_WINDOW: (f64, f64) = (0.35, 0.92);

/// Filling pauses where it is slower than this fraction of the waves before and after.
const PAUSE_FRACTION: f64 = 0.6;

impl VolumeCurve {
    /// Keeps volumes (mL) at ascending times (s) within one period (s).
    ///
    /// # Errors
    /// [`ImageError::InconsistentVolumeCurve`] if numbers differ, fewer than four instants are given, or values make no sense.
    pub fn new(times_s: Vec<f64>, volumes_ml: Vec<f64>, period_s: f64) -> Result<Self, ImageError> {
        let inconsistent = |reason: String| Err(ImageError::InconsistentVolumeCurve { reason });
        if times_s.len() != volumes_ml.len() || times_s.len() < 4 {
            return inconsistent(format!("{} times and {} volumes; four or more of each are needed", times_s.len(), volumes_ml.len()));
        }
        if let Some(frame) = volumes_ml.iter().position(|v| !(v.is_finite() && *v > 0.0)) {
            return inconsistent(format!("the volume at instant {frame} is {} mL", volumes_ml[frame]));
        }
        let span_s = times_s[times_s.len() - 1] - times_s[0];
        if !(times_s.windows(2).all(|pair| pair[0] < pair[1]) && span_s.is_finite() && period_s.is_finite() && period_s > span_s) {
            return inconsistent(format!("its times must ascend within the heart period of {period_s} s"));
        }
        Ok(Self { times_s, volumes_ml, period_s })
    }

    /// Counts the voxels with `code` in the label map of every frame, in the slices (index k) of `slices`.
    ///
    /// # Errors
    /// As [`VolumeCurve::new`].
    pub fn from_label_maps(
        maps: &[LabelMap],
        code: u8,
        slices: std::ops::Range<usize>,
        times_s: Vec<f64>,
        period_s: f64,
    ) -> Result<Self, ImageError> {
        let volume_ml = |map: &LabelMap| {
            let [ni, nj, nk] = map.grid().shape();
            let chosen = &map.labels()[ni * nj * slices.start.min(nk)..ni * nj * slices.end.clamp(slices.start.min(nk), nk)];
            chosen.iter().filter(|&&label| label == code).count() as f64 * map.grid().voxel_volume_mm3() / 1000.0
        };
        Self::new(times_s, maps.iter().map(volume_ml).collect(), period_s)
    }

    /// Instants, s, ascending.
    pub fn times_s(&self) -> &[f64] {
        &self.times_s
    }

    /// Volumes at the instants, mL.
    pub fn volumes_ml(&self) -> &[f64] {
        &self.volumes_ml
    }

    /// Heart period, s.
    pub fn period_s(&self) -> f64 {
        self.period_s
    }

    /// Volume (mL) at any time (s), linear between instants, periodic.
    pub fn volume_at_ml(&self, time_s: f64) -> f64 {
        let phase_s = self.times_s[0] + (time_s - self.times_s[0]).rem_euclid(self.period_s);
        let frame = self.times_s.partition_point(|&t| t <= phase_s).max(1) - 1;
        let weight = (phase_s - self.times_s[frame]) / self.step_after_s(frame);
        let next = self.volumes_ml[(frame + 1) % self.volumes_ml.len()];
        self.volumes_ml[frame] + weight * (next - self.volumes_ml[frame])
    }

    /// The largest volume (the first, of equal ones).
    pub fn end_diastole(&self) -> CurvePoint {
        self.point((0..self.len()).fold(0, |best, n| if self.volumes_ml[n] > self.volumes_ml[best] { n } else { best }))
    }

    /// The smallest volume (the first, of equal ones).
    pub fn end_systole(&self) -> CurvePoint {
        self.point((0..self.len()).fold(0, |best, n| if self.volumes_ml[n] < self.volumes_ml[best] { n } else { best }))
    }

    /// (EDV − ESV)/EDV.
    pub fn ejection_fraction(&self) -> f64 {
        let (end_diastolic_ml, end_systolic_ml) = (self.end_diastole().volume_ml, self.end_systole().volume_ml);
        (end_diastolic_ml - end_systolic_ml) / end_diastolic_ml
    }

    /// The instant of slowest filling between the early wave and the atrial kick (\[Billet2009\] §3 builds the mesh there). Smooth a
    /// noisy curve first.
    pub fn mid_diastole(&self) -> MidDiastole {
        let (start, end) = (self.end_systole().frame, self.end_diastole().frame);
        let filling: Vec<usize> = self.cycle_from(start).take_while(|&n| n != end).collect();
        let filling_s = self.elapsed_s(start, end);
        let share = |n: usize| self.elapsed_s(start, n) / filling_s;
        let rate = |n: usize| (self.volumes_ml[(n + 1) % self.len()] - self.volumes_ml[n]) / self.step_after_s(n);
        let within = |n: &usize| (DIASTASIS_WINDOW.0..=DIASTASIS_WINDOW.1).contains(&share(*n));
        let slowest = (1..filling.len()).filter(|&n| within(&filling[n])).min_by(|&a, &b| rate(filling[a]).total_cmp(&rate(filling[b])));
        if let Some(at) = slowest {
            let fastest = |frames: &[usize]| frames.iter().map(|&n| rate(n)).fold(0.0, f64::max);
            let (early, late) = (fastest(&filling[..at]), fastest(&filling[at + 1..]));
            if rate(filling[at]) < PAUSE_FRACTION * early.min(late) {
                // The pause lies between this instant and the next; the kick begins at the later one.
                return MidDiastole { point: self.point(filling[(at + 1).min(filling.len() - 1)]), pause_seen: true };
            }
        }
        let usual = |n: &usize| (share(*n) - USUAL_DIASTASIS).abs();
        let frame = filling.iter().copied().min_by(|a, b| usual(a).total_cmp(&usual(b))).unwrap_or(start);
        MidDiastole { point: self.point(frame), pause_seen: false }
    }

    /// The smooth curve of one ejection and one filling that is nearest to this one; `weight` is λ above (0.5 suits 20 frames with
    /// a few mL of noise). ED and ES may move by one instant where that fits better.
    ///
    /// # Errors
    /// [`ImageError::InconsistentVolumeCurve`] if `weight` is negative or the quadratic program has no answer.
    pub fn smoothed(&self, weight: f64) -> Result<Self, ImageError> {
        self.with_volumes(self.nearest_beat(weight)?.volumes_ml)
    }

    /// The smooth curves of two ventricles that are nearest to their measured ones and eject the same volume, $v^L_{ED} - v^L_{ES} = v^R_{ED} - v^R_{ES}$:
    /// one program for both, with the turning points that each has on its own.
    ///
    /// # Errors
    /// As [`VolumeCurve::smoothed`].
    pub fn smoothed_to_equal_strokes(left: &Self, right: &Self, weight: f64) -> Result<(Self, Self), ImageError> {
        let failed = |error: QpError| ImageError::InconsistentVolumeCurve { reason: error.to_string() };
        let (lefts, rights) = (left.nearest_beat(weight)?, right.nearest_beat(weight)?);
        let (m, n) = (left.len(), right.len());
        let block = |one: DMatrix<f64>, other: DMatrix<f64>| {
            let mut both = DMatrix::zeros(m + n, m + n);
            both.view_mut((0, 0), (m, m)).copy_from(&one);
            both.view_mut((m, m), (n, n)).copy_from(&other);
            both
        };
        let measured = DVector::from_iterator(m + n, left.volumes_ml.iter().chain(&right.volumes_ml).copied());
        let mut strokes = DMatrix::zeros(1, m + n);
        for (place, sign) in
            [(lefts.end_diastole, 1.0), (lefts.end_systole, -1.0), (m + rights.end_diastole, -1.0), (m + rights.end_systole, 1.0)]
        {
            strokes[(0, place)] = sign;
        }
        let rows =
            block(left.monotone_rows(lefts.end_diastole, lefts.end_systole), right.monotone_rows(rights.end_diastole, rights.end_systole));
        let program = QuadraticProgram::new(block(left.hessian(weight), right.hessian(weight)), -2.0 * measured)
            .and_then(|program| program.with_inequalities(rows, DVector::zeros(m + n)))
            .and_then(|program| program.with_equalities(strokes, DVector::zeros(1)))
            .map_err(failed)?;
        let volumes_ml = program.solve().map_err(failed)?.x;
        Ok((left.with_volumes(volumes_ml.as_slice()[..m].to_vec())?, right.with_volumes(volumes_ml.as_slice()[m..].to_vec())?))
    }

    /// The same curve with all volumes times a factor.
    ///
    /// # Errors
    /// [`ImageError::InconsistentVolumeCurve`] if the factor is not positive and finite.
    pub fn scaled(&self, factor: f64) -> Result<Self, ImageError> {
        self.with_volumes(self.volumes_ml.iter().map(|volume_ml| factor * volume_ml).collect())
    }

    fn with_volumes(&self, volumes_ml: Vec<f64>) -> Result<Self, ImageError> {
        Self::new(self.times_s.clone(), volumes_ml, self.period_s)
    }

    /// 2 (I + λ Δ²ᵀ Δ²).
    fn hessian(&self, weight: f64) -> DMatrix<f64> {
        let second = self.second_differences();
        2.0 * (DMatrix::identity(self.len(), self.len()) + weight * second.transpose() * second)
    }

    fn nearest_beat(&self, weight: f64) -> Result<NearestBeat, ImageError> {
        let failed = |reason: String| ImageError::InconsistentVolumeCurve { reason };
        if !(weight >= 0.0 && weight.is_finite()) {
            return Err(failed(format!("a smoothing weight of {weight} is not usable")));
        }
        let count = self.len();
        let hessian = self.hessian(weight);
        let measured = DVector::from_column_slice(&self.volumes_ml);
        let mut best: Option<(f64, NearestBeat)> = None;
        for (end_diastole, end_systole) in self.turning_points() {
            let program = QuadraticProgram::new(hessian.clone(), -2.0 * &measured)
                .and_then(|program| {
                    program.with_inequalities(self.monotone_rows(end_diastole, end_systole), DVector::from_element(count, 0.0))
                })
                .map_err(|error| failed(error.to_string()))?;
            let solution = program.solve().map_err(|error| failed(error.to_string()))?;
            if best.as_ref().is_none_or(|(objective, _)| solution.objective < *objective) {
                best = Some((solution.objective, NearestBeat { end_diastole, end_systole, volumes_ml: solution.x.as_slice().to_vec() }));
            }
        }
        best.map(|(_, beat)| beat).ok_or_else(|| failed("end-diastole and end-systole coincide".into()))
    }

    fn len(&self) -> usize {
        self.times_s.len()
    }

    fn point(&self, frame: usize) -> CurvePoint {
        CurvePoint { frame, time_s: self.times_s[frame], volume_ml: self.volumes_ml[frame] }
    }

    fn step_after_s(&self, frame: usize) -> f64 {
        if frame + 1 < self.len() {
            self.times_s[frame + 1] - self.times_s[frame]
        } else {
            self.times_s[0] + self.period_s - self.times_s[frame]
        }
    }

    fn elapsed_s(&self, from: usize, to: usize) -> f64 {
        let elapsed_s = (self.times_s[to] - self.times_s[from]).rem_euclid(self.period_s);
        if elapsed_s == 0.0 && from != to { self.period_s } else { elapsed_s }
    }

    fn cycle_from(&self, start: usize) -> impl Iterator<Item = usize> {
        let count = self.len();
        (0..count).map(move |n| (start + n) % count)
    }

    /// Rows 2 h̄² [v_{i−1}/(h₋(h₋+h₊)) − v_i/(h₋h₊) + v_{i+1}/(h₊(h₋+h₊))] with h̄ the mean step: the usual (1, −2, 1) for even steps.
    fn second_differences(&self) -> DMatrix<f64> {
        let count = self.len();
        let mean_s = self.period_s / count as f64;
        let mut rows = DMatrix::zeros(count, count);
        for n in 0..count {
            let previous = (n + count - 1) % count;
            let (before_s, after_s) = (self.step_after_s(previous) / mean_s, self.step_after_s(n) / mean_s);
            rows[(n, previous)] += 2.0 / (before_s * (before_s + after_s));
            rows[(n, n)] -= 2.0 / (before_s * after_s);
            rows[(n, (n + 1) % count)] += 2.0 / (after_s * (before_s + after_s));
        }
        rows
    }

    /// Rows r · v ≤ 0: v falls from one instant to the next between ED and ES, and rises elsewhere.
    fn monotone_rows(&self, end_diastole: usize, end_systole: usize) -> DMatrix<f64> {
        let count = self.len();
        let mut rows = DMatrix::zeros(count, count);
        let ejecting = (end_systole + count - end_diastole) % count;
        for (row, n) in self.cycle_from(end_diastole).enumerate() {
            let sign = if row < ejecting { 1.0 } else { -1.0 };
            rows[(row, (n + 1) % count)] = sign;
            rows[(row, n)] = -sign;
        }
        rows
    }

    /// Pairs of (ED, ES) around the extremes of the curve averaged over three instants.
    fn turning_points(&self) -> Vec<(usize, usize)> {
        let count = self.len();
        let at = |n: usize, shift: usize| (n + count + shift - 1) % count;
        let averaged = (0..count).map(|n| (0..3).map(|shift| self.volumes_ml[at(n, shift)]).sum::<f64>() / 3.0).collect();
        let calmer = Self { volumes_ml: averaged, ..self.clone() };
        let (end_diastole, end_systole) = (calmer.end_diastole().frame, calmer.end_systole().frame);
        let pairs = (0..9).map(|n| (at(end_diastole, n % 3), at(end_systole, n / 3)));
        pairs.filter(|(diastole, systole)| diastole != systole).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use rand_distr::{Distribution, Normal};

    /// 130 → 60 mL in 0.3 of the beat, back by an early wave, a pause from 0.62 to 0.8, and a kick.
    fn heart(phase: f64) -> f64 {
        let smooth = |t: f64| {
            if t <= 0.0 {
                0.0
            } else if t >= 1.0 {
                1.0
            } else {
                t * t * (3.0 - 2.0 * t)
            }
        };
        let phase = phase.rem_euclid(1.0);
        130.0 - 70.0 * smooth((phase - 0.05) / 0.3) + 50.0 * smooth((phase - 0.4) / 0.22) + 20.0 * smooth((phase - 0.8) / 0.18)
    }

    fn measured(frames: usize, noise_ml: f64, seed: u64) -> VolumeCurve {
        let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(seed);
        let noise = Normal::new(0.0, noise_ml).unwrap();
        let times_s: Vec<f64> = (0..frames).map(|n| 0.02 + 0.9 * n as f64 / frames as f64).collect();
        let volumes = times_s.iter().map(|t| heart(t / 0.9) + noise.sample(&mut random)).collect();
        VolumeCurve::new(times_s, volumes, 0.9).unwrap()
    }

    fn error_ml(curve: &VolumeCurve) -> f64 {
        let squares: f64 = curve.times_s().iter().zip(curve.volumes_ml()).map(|(t, v)| (v - heart(t / 0.9)).powi(2)).sum();
        (squares / curve.times_s().len() as f64).sqrt()
    }

    #[test]
    fn landmarks_of_a_known_curve_are_found() {
        let curve = measured(30, 0.0, 0);
        assert!((curve.ejection_fraction() - 70.0 / 130.0).abs() < 0.005);
        assert!((curve.end_systole().time_s / 0.9 - 0.37).abs() < 0.04);
        let diastasis = curve.mid_diastole();
        assert!(diastasis.pause_seen);
        assert!((0.62..=0.83).contains(&(diastasis.point.time_s / 0.9)), "{diastasis:?}");
        assert!((diastasis.point.volume_ml - 110.0).abs() < 1.0);
    }

    #[test]
    fn without_a_pause_diastasis_is_placed_by_its_usual_time() {
        let times_s: Vec<f64> = (0..20).map(|n| 0.035 * f64::from(n)).collect();
        let volumes = times_s.iter().map(|t| 100.0 + 30.0 * (std::f64::consts::TAU * t / 0.7).cos()).collect();
        let found = VolumeCurve::new(times_s, volumes, 0.7).unwrap().mid_diastole();
        assert!(!found.pause_seen);
        assert!((found.point.time_s - (0.35 + 0.7 * 0.35)).abs() < 0.036, "{found:?}");
    }

    /// Over many noisy curves the smooth one is nearer to the truth than the measurements, and never less than monotone.
    #[test]
    fn smoothing_brings_a_noisy_curve_nearer_to_the_truth_and_makes_it_beat_once() {
        let (mut before, mut after) = (0.0, 0.0);
        for seed in 0..20 {
            let curve = measured(25, 4.0, seed);
            let smooth = curve.smoothed(0.5).unwrap();
            before += error_ml(&curve);
            after += error_ml(&smooth);
            let (top, bottom) = (smooth.end_diastole().frame, smooth.end_systole().frame);
            let v = smooth.volumes_ml();
            let mut n = top;
            while n != bottom {
                assert!(v[(n + 1) % 25] <= v[n] + 1e-6);
                n = (n + 1) % 25;
            }
            while n != top {
                assert!(v[(n + 1) % 25] >= v[n] - 1e-6);
                n = (n + 1) % 25;
            }
        }
        assert!(after < 0.75 * before, "RMS error {} → {} mL", before / 20.0, after / 20.0);
    }

    #[test]
    fn a_smooth_curve_is_hardly_changed_and_zero_weight_keeps_a_monotone_one() {
        let curve = measured(40, 0.0, 0);
        assert!(error_ml(&curve.smoothed(0.1).unwrap()) < 0.5);
        let kept = curve.smoothed(0.0).unwrap();
        assert!(kept.volumes_ml().iter().zip(curve.volumes_ml()).all(|(a, b)| (a - b).abs() < 1e-5));
    }

    #[test]
    fn two_ventricles_eject_the_same_and_stay_near_what_was_measured() {
        let left = measured(24, 1.5, 3);
        let right = measured(30, 1.5, 4).scaled(1.2).unwrap();
        let stroke = |curve: &VolumeCurve| curve.end_diastole().volume_ml - curve.end_systole().volume_ml;
        let (alone_left, alone_right) = (left.smoothed(0.5).unwrap(), right.smoothed(0.5).unwrap());
        assert!(stroke(&alone_right) - stroke(&alone_left) > 10.0);
        let (matched_left, matched_right) = VolumeCurve::smoothed_to_equal_strokes(&left, &right, 0.5).unwrap();
        assert!((stroke(&matched_left) - stroke(&matched_right)).abs() < 1e-5);
        assert!(stroke(&matched_left) > stroke(&alone_left) && stroke(&matched_right) < stroke(&alone_right));
        // Curves that agree already are left alone.
        let (same, _) = VolumeCurve::smoothed_to_equal_strokes(&left, &left, 0.5).unwrap();
        assert!(same.volumes_ml().iter().zip(alone_left.volumes_ml()).all(|(a, b)| (a - b).abs() < 1e-4));
        assert!(left.scaled(0.0).is_err());
    }

    #[test]
    fn interpolation_is_periodic() {
        let curve = measured(30, 0.0, 0);
        assert!((curve.volume_at_ml(0.02) - curve.volumes_ml()[0]).abs() < 1e-12);
        assert!((curve.volume_at_ml(0.37) - curve.volume_at_ml(0.37 - 0.9)).abs() < 1e-9);
        assert!((curve.volume_at_ml(0.015) - heart(0.015 / 0.9)).abs() < 0.5);
    }

    #[test]
    fn senseless_curves_are_refused() {
        let new = |times: &[f64], volumes: &[f64], period| VolumeCurve::new(times.to_vec(), volumes.to_vec(), period);
        assert!(new(&[0.0, 0.1, 0.2], &[1.0; 3], 1.0).is_err());
        assert!(new(&[0.0, 0.1, 0.2, 0.3], &[1.0, 1.0, f64::NAN, 1.0], 1.0).is_err());
        assert!(new(&[0.0, 0.1, 0.2, 0.3], &[1.0, 1.0, -1.0, 1.0], 1.0).is_err());
        assert!(new(&[0.0, 0.2, 0.1, 0.3], &[1.0; 4], 1.0).is_err());
        assert!(new(&[0.0, 0.1, 0.2, 0.3], &[1.0; 4], 0.2).is_err());
        assert!(measured(20, 0.0, 0).smoothed(-1.0).is_err());
    }
}
