//! The figures that a run of a beat gives, by the names under which its files have them: what a sensitivity study may ask for.

use crate::heart::Parameter;

/// Figures of every beat, as `summary.json` names them.
pub(super) const BEAT_FIGURES: &[&str] = &[
    "ejection_fraction_lv",
    "end_diastolic_volume_lv_ml",
    "end_systolic_volume_lv_ml",
    "stroke_volume_lv_ml",
    "pressure_peak_lv_mmhg",
    "pressure_end_diastolic_lv_mmhg",
    "pressure_rate_max_lv_mmhg_per_s",
    "pressure_systolic_aorta_mmhg",
    "pressure_diastolic_aorta_mmhg",
    "isovolumetric_contraction_lv_ms",
    "ejection_lv_ms",
    "isovolumetric_relaxation_lv_ms",
    "filling_lv_ms",
    "ejection_fraction_rv",
    "end_diastolic_volume_rv_ml",
    "end_systolic_volume_rv_ml",
    "stroke_volume_rv_ml",
    "pressure_peak_rv_mmhg",
    "pressure_end_diastolic_rv_mmhg",
    "pressure_rate_max_rv_mmhg_per_s",
    "pressure_systolic_pulmonary_mmhg",
    "pressure_diastolic_pulmonary_mmhg",
    "isovolumetric_contraction_rv_ms",
    "ejection_rv_ms",
    "isovolumetric_relaxation_rv_ms",
    "filling_rv_ms",
    "total_activation_time_ms",
    "activation_time_lv_ms",
    "activation_time_rv_ms",
    "end_diastole_s",
    "end_systole_s",
    "strain_circumferential_lv",
    "strain_longitudinal_lv",
    "strain_radial_lv",
    "wall_thickening_lv",
    "twist_lv_deg",
    "torsion_lv_deg_per_mm",
    "base_descent_mm",
];

/// Figures of every AHA segment, as the columns of `segments.csv` are named; written `segment_7_strain_radial_peak`.
pub(super) const SEGMENT_FIGURES: &[&str] = &[
    "activation_time_s",
    "strain_circumferential_end_systole",
    "strain_longitudinal_end_systole",
    "strain_radial_end_systole",
    "strain_circumferential_peak",
    "strain_longitudinal_peak",
    "strain_radial_peak",
    "strain_circumferential_peak_time_s",
    "thickness_end_diastole_mm",
    "thickening",
];

/// Figures of a tracked beat.
pub(super) const TRACKING_FIGURES: &[&str] = &[
    "image_residual_mm",
    "image_residual_endocardium_lv_mm",
    "image_residual_epicardium_mm",
    "image_residual_held_out_mm",
    "image_work_mj",
];

/// Figures of a tracked phantom beside its truth.
pub(super) const TRUTH_FIGURES: &[&str] = &["tracking_rmse_mm", "tracking_rmse_greatest_mm", "tracking_volume_rms_lv_ml"];

/// What the names of parameters found in every run begin with; see `[personalisation]`.
pub(super) const RECOVERED: &str = "recovered_";

/// The figure of a segment that a name stands for.
pub(super) fn segment_figure(name: &str) -> Option<(u8, &'static str)> {
    let (segment, figure) = name.strip_prefix("segment_")?.split_once('_')?;
    let figure = SEGMENT_FIGURES.iter().find(|known| **known == figure)?;
    let segment = segment.parse().ok().filter(|number: &u8| (1..=17).contains(number) && *segment == number.to_string())?;
    Some((segment, figure))
}

/// The unit of a figure, which its name ends with; `1` for shares and strains.
pub(super) fn unit_of(name: &str) -> &'static str {
    const ENDINGS: &[(&str, &str)] = &[
        ("_mmhg_per_s", "mmHg/s"),
        ("_deg_per_mm", "°/mm"),
        ("_mmhg", "mmHg"),
        ("_ml", "mL"),
        ("_mm", "mm"),
        ("_ms", "ms"),
        ("_mj", "mJ"),
        ("_deg", "°"),
        ("_s", "s"),
    ];
    if let Some(parameter) = name.strip_prefix(RECOVERED).and_then(Parameter::from_name) {
        return parameter.spec().unit;
    }
    ENDINGS.iter().find(|(ending, _)| name.ends_with(ending)).map_or("1", |(_, unit)| unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The fields of a record in this source, `pub(super)` or not.
    fn fields<'s>(source: &'s str, record: &str) -> Vec<&'s str> {
        let body = source.split_once(&format!("struct {record} {{")).unwrap().1.split_once("\n}").unwrap().0;
        let field = |line: &'s str| line.trim().trim_start_matches("pub(super) ").split_once(": ").map(|(name, _)| name);
        body.lines().filter(|line| !line.trim().starts_with(['/', '#'])).filter_map(field).collect()
    }

    #[test]
    fn every_figure_is_one_that_a_run_writes_and_none_is_left_out() {
        let (leave, wall) = (include_str!("run/leave.rs"), include_str!("run/wall.rs"));
        let written: Vec<&str> = fields(leave, "BeatSummary").into_iter().filter(|name| *name != "wall").collect();
        let written: Vec<&str> =
            written.into_iter().chain(fields(wall, "WallSummary")).filter(|name| *name != "divided_step_count").collect();
        assert_eq!(written, BEAT_FIGURES);
        assert_eq!(fields(wall, "SegmentRow")[1..], *SEGMENT_FIGURES);
        let tracked = fields(include_str!("run/sensitivity/figures.rs"), "TrackingFigures");
        assert_eq!(tracked, [TRACKING_FIGURES, TRUTH_FIGURES].concat());
    }

    #[test]
    fn segments_are_named_by_number_and_units_by_the_ending() {
        assert_eq!(segment_figure("segment_7_strain_radial_peak"), Some((7, "strain_radial_peak")));
        for wrong in ["segment_0_thickening", "segment_18_thickening", "segment_07_thickening", "segment_7", "thickening"] {
            assert_eq!(segment_figure(wrong), None, "{wrong}");
        }
        let units = ["pressure_rate_max_lv_mmhg_per_s", "ejection_lv_ms", "torsion_lv_deg_per_mm", "ejection_fraction_lv"].map(unit_of);
        assert_eq!(units, ["mmHg/s", "ms", "°/mm", "1"]);
    }
}
