//! The deformation of the wall over one beat, against end-diastole: curves of strain, and the figures at end-systole.

use nalgebra::Vector3;

use super::{CurveRow, Deformation, FrameState, Strain, phase_events};
use crate::anatomy::{Anatomy, Ventricle};
use crate::circulation::Phase;

/// Deformation of the left ventricle in one beat. The reference is end-diastole, where the mitral valve shuts (the beat's start if it
/// was shut by then); end-systole is where the aortic valve shuts (the smallest volume if it does not).
#[derive(Debug, Clone, PartialEq)]
pub struct BeatDeformation {
    /// End-diastole, s.
    pub end_diastole_s: f64,
    /// End-systole, s.
    pub end_systole_s: f64,
    /// The reference: position of every vertex at end-diastole, mm.
    pub reference_mm: Vec<Vector3<f64>>,
    /// The deformation at end-systole.
    pub end_systole: Deformation,
    /// Time of every frame, s.
    pub times_s: Vec<f64>,
    /// The deformation of every frame.
    pub frames: Vec<Deformation>,
}

/// Peak strains of an AHA segment in a beat, signed, and when they are reached.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PeakStrain {
    /// The strain of largest magnitude in the direction of systole: shortening around and along, thickening across.
    pub strain: Strain,
    /// When the circumferential one is reached, s.
    pub circumferential_time_s: f64,
}

impl BeatDeformation {
    /// The beat from `start_s` for `period_s`, from its frames (ascending, within the beat) and the curves; `None` without frames or
    /// without a left ventricle.
    pub fn of_beat(anatomy: &Anatomy, frames: &[FrameState], curves: &[CurveRow], start_s: f64, period_s: f64) -> Option<Self> {
        let (first, last) = (frames.first()?, frames.last()?);
        let tolerance_s = 1e-9 * period_s;
        let is_inside = |time_s: f64| time_s >= start_s - tolerance_s && time_s <= start_s + period_s + tolerance_s;
        let rows: Vec<CurveRow> = curves.iter().filter(|row| is_inside(row.time_s)).copied().collect();
        let smallest = rows
            .iter()
            .filter(|row| row.volume_lv_ml.is_some())
            .min_by(|a, b| a.volume_lv_ml.partial_cmp(&b.volume_lv_ml).unwrap_or(std::cmp::Ordering::Equal))?;
        let events = phase_events(&rows, Ventricle::Left);
        let begin_of = |phase| events.iter().find(|event| event.begins == phase).map(|event| event.time_s);
        let begins_filling = rows.first().and_then(|row| row.phase_lv) == Some(Phase::Filling);
        let end_diastole_s = begin_of(Phase::IsovolumetricContraction).filter(|_| begins_filling).unwrap_or(start_s);
        let end_systole_s = begin_of(Phase::IsovolumetricRelaxation).unwrap_or(smallest.time_s);
        let at = |time_s: f64| position_at(frames, time_s.clamp(first.time_s, last.time_s));
        let reference_mm = at(end_diastole_s);
        Some(Self {
            end_diastole_s,
            end_systole_s,
            end_systole: Deformation::between(anatomy, &reference_mm, &at(end_systole_s)),
            times_s: frames.iter().map(|frame| frame.time_s).collect(),
            frames: frames.iter().map(|frame| Deformation::between(anatomy, &reference_mm, &frame.position_mm)).collect(),
            reference_mm,
        })
    }

    /// Peak strains of an AHA segment; `None` if the anatomy does not have it.
    pub fn peak_strain(&self, segment: u8) -> Option<PeakStrain> {
        let strains: Vec<(f64, Strain)> = self.times_s.iter().copied().zip(self.strains_of(segment)).collect();
        let least = |value: fn(&Strain) -> f64| strains.iter().map(|(time_s, s)| (*time_s, value(s))).min_by(|a, b| a.1.total_cmp(&b.1));
        let (circumferential_time_s, circumferential) = least(|s| s.circumferential)?;
        let longitudinal = least(|s| s.longitudinal)?.1;
        let radial = -least(|s| -s.radial)?.1;
        Some(PeakStrain { strain: Strain { circumferential, longitudinal, radial }, circumferential_time_s })
    }

    /// Mechanical dispersion, s: the standard deviation over the AHA segments 1 to 16 of the time at which each is shortest around the
    /// cavity, \[Haugaa2010\] (who take the strain along it). It resolves what the frames do. `None` for fewer than two segments.
    pub fn mechanical_dispersion_s(&self) -> Option<f64> {
        let times_s: Vec<f64> = (1..=16).filter_map(|segment| Some(self.peak_strain(segment)?.circumferential_time_s)).collect();
        let count = times_s.len() as f64;
        let mean_s = times_s.iter().sum::<f64>() / count;
        let sum_s2: f64 = times_s.iter().map(|time_s| (time_s - mean_s).powi(2)).sum();
        (times_s.len() > 1).then(|| (sum_s2 / (count - 1.0)).sqrt())
    }

    /// Strains of an AHA segment, a frame each; empty if the anatomy does not have it.
    pub fn strains_of(&self, segment: u8) -> Vec<Strain> {
        let of = |frame: &Deformation| frame.segments.iter().find(|s| s.segment == segment).map(|s| s.strain);
        self.frames.iter().filter_map(of).collect()
    }
}

/// Positions between two frames, linear in time.
fn position_at(frames: &[FrameState], time_s: f64) -> Vec<Vector3<f64>> {
    let next = frames.partition_point(|frame| frame.time_s < time_s).min(frames.len() - 1);
    let (before, after) = (&frames[next.saturating_sub(1)], &frames[next]);
    let span_s = after.time_s - before.time_s;
    let weight = if span_s > 0.0 { ((time_s - before.time_s) / span_s).clamp(0.0, 1.0) } else { 0.0 };
    before.position_mm.iter().zip(&after.position_mm).map(|(b, a)| b + (a - b) * weight).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::heart::idealised_lv::IdealisedLv;
    use crate::units::kpa_from_mmhg;

    /// The wall narrows by 20 % from 0.1 to 0.4 s and widens again till 0.7 s; valves shut at 0.1 and 0.4 s.
    fn beat() -> (Anatomy, Vec<FrameState>, Vec<CurveRow>) {
        let anatomy = IdealisedLv { resolution: [12, 6, 1], ..IdealisedLv::default() }.anatomy();
        let width = |time_s: f64| 1.0 - 0.2 * (1.0 - ((time_s - 0.4) / 0.3).abs()).max(0.0);
        let frame = |number: u32| {
            let time_s = 0.05 * f64::from(number);
            let squeeze = |x: &Vector3<f64>| Vector3::new(x.x * width(time_s), x.y * width(time_s), x.z);
            FrameState {
                time_s,
                position_mm: anatomy.mesh.vertices_mm().iter().map(squeeze).collect(),
                volume_ml: vec![],
                pressure_kpa: vec![],
            }
        };
        let row = |step: u32| {
            let time_s = 0.01 * f64::from(step);
            let phase = match step {
                ..=10 => Phase::Filling,
                11..=15 => Phase::IsovolumetricContraction,
                16..=40 => Phase::Ejection,
                41..=50 => Phase::IsovolumetricRelaxation,
                _ => Phase::Filling,
            };
            CurveRow {
                phase_lv: Some(phase),
                volume_lv_ml: Some(100.0 * width(time_s)),
                pressure_lv_kpa: Some(kpa_from_mmhg(if (11..=40).contains(&step) { 100.0 } else { 5.0 })),
                pressure_aorta_kpa: Some(kpa_from_mmhg(90.0)),
                pressure_atrium_left_kpa: Some(kpa_from_mmhg(8.0)),
                flow_aorta_ml_per_s: Some(0.0),
                flow_mitral_ml_per_s: Some(0.0),
                ..CurveRow::empty(time_s)
            }
        };
        let frames = (0..=16).map(frame).collect();
        (anatomy, frames, (0..=80).map(row).collect())
    }

    #[test]
    fn a_known_narrowing_is_the_strain_at_end_systole_and_its_peak() {
        let (anatomy, frames, curves) = beat();
        let beat = BeatDeformation::of_beat(&anatomy, &frames, &curves, 0.0, 0.8).unwrap();
        assert!(
            (beat.end_diastole_s - 0.1).abs() < 0.01 && (beat.end_systole_s - 0.4).abs() < 0.01,
            "{} {}",
            beat.end_diastole_s,
            beat.end_systole_s
        );
        assert!((beat.end_systole.strain.circumferential + 0.2).abs() < 5e-3, "{}", beat.end_systole.strain.circumferential);
        for segment in 1..=17 {
            let peak = beat.peak_strain(segment).unwrap();
            assert!((peak.strain.circumferential + 0.2).abs() < 5e-3, "{peak:?}");
            assert!((peak.circumferential_time_s - 0.4).abs() < 1e-9, "{peak:?}");
        }
        assert!(beat.mechanical_dispersion_s().unwrap() < 1e-12, "all segments are shortest at once");
    }

    /// The wall narrows along x first and along y 0.2 s later: half of the segments at 0.3 s, half at 0.5 s, or nearly so.
    #[test]
    fn walls_that_are_shortest_at_two_times_are_dispersed_by_half_of_what_lies_between() {
        let (anatomy, mut frames, curves) = beat();
        let narrow = |time_s: f64, at_s: f64| 1.0 - 0.2 * (1.0 - ((time_s - at_s) / 0.3).abs()).max(0.0);
        for frame in &mut frames {
            let (x, y) = (narrow(frame.time_s, 0.3), narrow(frame.time_s, 0.5));
            frame.position_mm = anatomy.mesh.vertices_mm().iter().map(|p| Vector3::new(p.x * x, p.y * y, p.z)).collect();
        }
        let beat = BeatDeformation::of_beat(&anatomy, &frames, &curves, 0.0, 0.8).unwrap();
        let dispersion_s = beat.mechanical_dispersion_s().unwrap();
        assert!((0.06..0.11).contains(&dispersion_s), "{dispersion_s}");
    }

    #[test]
    fn a_beat_without_frames_has_no_deformation() {
        let (anatomy, frames, curves) = beat();
        assert_eq!(BeatDeformation::of_beat(&anatomy, &[], &curves, 0.0, 0.8), None);
        assert_eq!(BeatDeformation::of_beat(&anatomy, &frames, &[], 0.0, 0.8), None);
        let one = BeatDeformation::of_beat(&anatomy, &frames[..1], &curves, 0.0, 0.8).unwrap();
        assert!(one.end_systole.strain.circumferential.abs() < 1e-12, "one frame is its own reference");
    }
}
