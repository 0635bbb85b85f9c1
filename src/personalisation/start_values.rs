//! Start values from the volume curve, \[Billet2009\] §6.2: σ0 from the ejection fraction, onset and APD from the curve's timing.

use super::PersonalisationError;

/// Part of the stroke volume that has left when ejection counts as begun.
const EJECTED_AT_START: f64 = 0.1;

/// Where a volume curve turns: what start values need of it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VolumeTiming {
    /// Largest volume, mL.
    pub end_diastolic_volume_ml: f64,
    /// Smallest volume, mL.
    pub end_systolic_volume_ml: f64,
    /// When a tenth of the stroke volume has left, s.
    pub ejection_start_s: f64,
    /// When the volume is smallest (vertex of the parabola through three frames), s.
    pub end_systole_s: f64,
}

impl VolumeTiming {
    /// Reads one beat of a periodic curve: `times_s` ascending within one `period_s`, one volume a time. The beat may start anywhere.
    ///
    /// # Errors
    /// [`PersonalisationError`] if sizes differ, fewer than five frames are given, times do not ascend within the period, or the volume does not change.
    pub fn from_curve(times_s: &[f64], volumes_ml: &[f64], period_s: f64) -> Result<Self, PersonalisationError> {
        let count = times_s.len();
        if volumes_ml.len() != count || count < 5 {
            let (found, expected) = (volumes_ml.len(), count.max(5));
            return Err(PersonalisationError::Shape { what: "volumes of a beat", found, expected });
        }
        let span_s = times_s[count - 1] - times_s[0];
        if !(times_s.windows(2).all(|pair| pair[1] > pair[0]) && span_s < period_s) {
            let remedy = "times must ascend and end before the beat repeats";
            return Err(PersonalisationError::Setting { what: "span of the volume curve, s", value: span_s, remedy });
        }
        let lowest = (0..count).min_by(|&a, &b| volumes_ml[a].total_cmp(&volumes_ml[b])).unwrap_or(0);
        let highest = volumes_ml.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let stroke_ml = highest - volumes_ml[lowest];
        if !(stroke_ml.is_finite() && stroke_ml > 0.0) {
            return Err(PersonalisationError::Setting { what: "stroke volume, mL", value: stroke_ml, remedy: "must be positive" });
        }
        // Frame k, any integer, at its time in the periodic continuation.
        let frame = |k: isize| {
            let beat = k.div_euclid(count as isize);
            let index = k.rem_euclid(count as isize) as usize;
            (times_s[index] + beat as f64 * period_s, volumes_ml[index])
        };
        let end = lowest as isize;
        let end_systole_s = vertex(frame(end - 1), frame(end), frame(end + 1));
        let threshold_ml = highest - EJECTED_AT_START * stroke_ml;
        let crossing = (0..count as isize).map(|back| end - back).find(|&k| frame(k - 1).1 >= threshold_ml && frame(k).1 < threshold_ml);
        let ejection_start_s = crossing.map_or(end_systole_s, |k| {
            let ((before_s, before_ml), (after_s, after_ml)) = (frame(k - 1), frame(k));
            before_s + (after_s - before_s) * (before_ml - threshold_ml) / (before_ml - after_ml)
        });
        Ok(Self { end_diastolic_volume_ml: highest, end_systolic_volume_ml: volumes_ml[lowest], ejection_start_s, end_systole_s })
    }

    /// (EDV − ESV)/EDV.
    pub fn ejection_fraction(&self) -> f64 {
        1.0 - self.end_systolic_volume_ml / self.end_diastolic_volume_ml
    }

    /// Time from the start of ejection to end systole, s.
    pub fn ejection_duration_s(&self) -> f64 {
        self.end_systole_s - self.ejection_start_s
    }
}

/// Vertex of the parabola through three points, kept between the outer two.
fn vertex(left: (f64, f64), middle: (f64, f64), right: (f64, f64)) -> f64 {
    let (before, after) = (left.0 - middle.0, right.0 - middle.0);
    let (slope_before, slope_after) = ((left.1 - middle.1) / before, (right.1 - middle.1) / after);
    let curvature = (slope_after - slope_before) / (after - before);
    let slope = slope_before - curvature * before;
    let shift = if curvature > 0.0 { -slope / (2.0 * curvature) } else { 0.0 };
    middle.0 + shift.max(before).min(after)
}

/// Onset of depolarisation and action-potential duration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ElectricalTiming {
    /// First depolarisation, s.
    pub onset_time_s: f64,
    /// APD, s.
    pub action_potential_duration_s: f64,
}

impl ElectricalTiming {
    /// Without any simulation: ejection starts `isovolumic_contraction_s` (about 0.04–0.06 s) after the onset, and ends when the muscle
    /// depolarised at the middle of the activation has repolarised: APD = t_ES − t_onset − ½ T_activation.
    pub fn from_volume(measured: &VolumeTiming, isovolumic_contraction_s: f64, activation_span_s: f64) -> Self {
        let onset_time_s = measured.ejection_start_s - isovolumic_contraction_s;
        let action_potential_duration_s = measured.end_systole_s - onset_time_s - 0.5 * activation_span_s;
        Self { onset_time_s, action_potential_duration_s }
    }

    /// With one pilot simulation at `self`: what the pilot ejects too late is taken from the onset, what it ejects too long from the APD.
    /// Exact if the model's volume curve moves with the onset and stretches with the APD.
    #[must_use]
    pub fn corrected(self, pilot: &VolumeTiming, measured: &VolumeTiming) -> Self {
        Self {
            onset_time_s: self.onset_time_s + measured.ejection_start_s - pilot.ejection_start_s,
            action_potential_duration_s: self.action_potential_duration_s + measured.ejection_duration_s() - pilot.ejection_duration_s(),
        }
    }
}

/// Speed along the fibre, mm/s, from the longest way of the activation (mm, for example span × speed of a pilot activation) and a
/// measured span (s, for example the QRS duration).
pub fn conduction_velocity_mm_per_s(longest_way_mm: f64, activation_span_s: f64) -> f64 {
    longest_way_mm / activation_span_s
}

/// A parameter value found by pilot simulations.
#[derive(Debug, Clone, PartialEq)]
pub struct PilotFit {
    /// The value.
    pub value: f64,
    /// Ejection fraction (or whatever is matched) simulated with a value, in the order tried.
    pub pilots: Vec<(f64, f64)>,
}

/// σ0 (kPa) whose simulated ejection fraction is `target`, to within `tolerance`: secant steps in ln σ0 from `first` and a second
/// guess, kept within `lower` and `upper` and within the bracket once there is one; at most `most_pilots` simulations. The ejection
/// fraction grows with σ0. The best pilot's next secant point is returned without being simulated.
///
/// # Errors
/// [`PersonalisationError::Setting`] for bad bounds or fewer than two pilots, or the pilot's own error.
pub fn contraction_peak_for_ejection_fraction(
    target: f64,
    (lower, upper): (f64, f64),
    first: f64,
    tolerance: f64,
    most_pilots: usize,
    mut simulate: impl FnMut(f64) -> Result<f64, PersonalisationError>,
) -> Result<PilotFit, PersonalisationError> {
    if !(lower > 0.0 && lower < upper && most_pilots >= 1 && target.is_finite()) {
        let remedy = "bounds must be positive and ascending, the target finite, and at least one pilot is needed";
        return Err(PersonalisationError::Setting { what: "lower bound of the contraction", value: lower, remedy });
    }
    let (mut below, mut above) = (lower.ln(), upper.ln());
    let mut next = first.max(lower).min(upper).ln();
    let mut pilots: Vec<(f64, f64)> = Vec::new();
    loop {
        let reached = simulate(next.exp())?;
        pilots.push((next.exp(), reached));
        if (reached - target).abs() <= tolerance {
            return Ok(PilotFit { value: next.exp(), pilots });
        }
        if reached < target {
            below = next
        } else {
            above = next
        }
        let proposal = match pilots.as_slice() {
            [.., (earlier, was), (now, is)] if is != was => now.ln() + (target - is) * (now.ln() - earlier.ln()) / (is - was),
            // EF grows roughly like ln σ0 halfway up: a missing tenth asks for a quarter more.
            _ => next + 2.5 * (target - reached).clamp(-0.3, 0.3),
        };
        let inside = proposal > below && proposal < above;
        // Beyond a bound of the parameter itself: go to the bound, once.
        let clamped = proposal.max(lower.ln()).min(upper.ln());
        let tried = |value: f64| pilots.iter().any(|(pilot, _)| (pilot.ln() - value).abs() < 1e-12);
        next = if inside {
            proposal
        } else if !tried(clamped) && (below == lower.ln() || above == upper.ln()) {
            clamped
        } else {
            0.5 * (below + above)
        };
        if pilots.len() >= most_pilots || tried(next) {
            return Ok(PilotFit { value: next.exp(), pilots });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_S: f64 = 0.8;

    /// V(t) = 80 + 40 cos(2π(t − t₀)/T): largest at t₀, smallest at t₀ + T/2, a tenth ejected where the cosine is 0.8.
    fn cosine(shift_s: f64, count: usize) -> (Vec<f64>, Vec<f64>) {
        let times_s: Vec<f64> = (0..count).map(|k| PERIOD_S * k as f64 / count as f64).collect();
        let angle = |time_s: f64| std::f64::consts::TAU * (time_s - shift_s) / PERIOD_S;
        let volumes_ml = times_s.iter().map(|&time_s| 80.0 + 40.0 * angle(time_s).cos()).collect();
        (times_s, volumes_ml)
    }

    #[test]
    fn timing_of_a_cosine_is_read_between_frames() {
        for shift_s in [0.0, 0.013, 0.3, 0.7] {
            let (times_s, volumes_ml) = cosine(shift_s, 25);
            let timing = VolumeTiming::from_curve(&times_s, &volumes_ml, PERIOD_S).unwrap();
            let expected_s = (shift_s + 0.5 * PERIOD_S).rem_euclid(PERIOD_S);
            let wrapped = |error_s: f64| (error_s + 0.5 * PERIOD_S).rem_euclid(PERIOD_S) - 0.5 * PERIOD_S;
            assert!(wrapped(timing.end_systole_s - expected_s).abs() < 5e-4, "{shift_s}: {}", timing.end_systole_s);
            let start_s = shift_s + PERIOD_S * 0.8_f64.acos() / std::f64::consts::TAU;
            assert!(wrapped(timing.ejection_start_s - start_s).abs() < 3e-3, "{shift_s}: {}", timing.ejection_start_s);
            assert!(timing.ejection_duration_s() > 0.0 && timing.ejection_duration_s() < PERIOD_S);
            assert!((timing.ejection_fraction() - 80.0 / 120.0).abs() < 5e-3);
        }
    }

    #[test]
    fn curves_that_are_none_are_refused() {
        assert!(VolumeTiming::from_curve(&[0.0, 0.1], &[1.0, 2.0], 1.0).is_err());
        let (times_s, volumes_ml) = cosine(0.0, 20);
        assert!(VolumeTiming::from_curve(&times_s, &volumes_ml, 0.5).is_err());
        assert!(VolumeTiming::from_curve(&times_s, &[100.0; 20], PERIOD_S).is_err());
        assert!(VolumeTiming::from_curve(&times_s, &[f64::NAN; 20], PERIOD_S).is_err());
    }

    /// A model whose curve moves with the onset and stretches with the APD is corrected exactly by one pilot.
    #[test]
    fn one_pilot_corrects_a_shift_and_a_stretch() {
        let simulate = |timing: ElectricalTiming| VolumeTiming {
            end_diastolic_volume_ml: 120.0,
            end_systolic_volume_ml: 50.0,
            ejection_start_s: timing.onset_time_s + 0.057,
            end_systole_s: timing.onset_time_s + 0.031 + timing.action_potential_duration_s,
        };
        let truth = ElectricalTiming { onset_time_s: 0.03, action_potential_duration_s: 0.31 };
        let measured = simulate(truth);
        let first = ElectricalTiming::from_volume(&measured, 0.05, 0.06);
        assert!((first.onset_time_s - truth.onset_time_s).abs() < 0.01, "without a pilot within 10 ms");
        let corrected = first.corrected(&simulate(first), &measured);
        assert!((corrected.onset_time_s - truth.onset_time_s).abs() < 1e-12);
        assert!((corrected.action_potential_duration_s - truth.action_potential_duration_s).abs() < 1e-12);
    }

    /// A saturating EF(σ0) like that of a beating LV.
    fn ejection_fraction(peak_kpa: f64) -> f64 {
        0.75 * (peak_kpa - 20.0).max(0.0) / (peak_kpa + 60.0)
    }

    #[test]
    fn few_pilots_find_the_contraction_for_an_ejection_fraction() {
        for target in [0.15, 0.25, 0.4, 0.55] {
            let fit =
                contraction_peak_for_ejection_fraction(target, (20.0, 400.0), 90.0, 0.005, 6, |peak| Ok(ejection_fraction(peak))).unwrap();
            assert!((ejection_fraction(fit.value) - target).abs() < 0.01, "{target}: {:?}", fit.pilots);
            assert!(fit.pilots.len() <= 5, "{target}: {} pilots", fit.pilots.len());
        }
    }

    #[test]
    fn targets_out_of_reach_end_at_the_bound() {
        let fit = contraction_peak_for_ejection_fraction(0.9, (20.0, 400.0), 90.0, 0.005, 6, |peak| Ok(ejection_fraction(peak))).unwrap();
        assert!((fit.value - 400.0).abs() < 1.0, "{:?}", fit);
        assert!(contraction_peak_for_ejection_fraction(0.5, (0.0, 400.0), 90.0, 0.005, 6, |_| Ok(0.5)).is_err());
    }
}
