//! Headings of tables in words: the columns of a CSV file are `volume_lv_ml`, those of a page `Volume LV, mL`.

/// Ends of names and the units they stand for; longer ones first.
const UNITS: [(&str, &str); 16] = [
    ("_mmhg_per_s", "mmHg/s"),
    ("_kpa_per_mm", "kPa/mm"),
    ("_mm_per_s", "mm/s"),
    ("_kpa_per_s", "kPa/s"),
    ("_per_s", "1/s"),
    ("_percent", "%"),
    ("_mmhg", "mmHg"),
    ("_kpa", "kPa"),
    ("_deg", "°"),
    ("_ml", "mL"),
    ("_mm", "mm"),
    ("_ms", "ms"),
    ("_mj", "mJ"),
    ("_mb", "MB"),
    ("_hz", "Hz"),
    ("_s", "s"),
];

/// Words that are written in capitals.
const CAPITALS: [&str; 9] = ["lv", "rv", "rms", "ef", "edv", "esv", "aha", "apd", "id"];

/// The name of a column as a heading: its words, and its unit behind a comma.
pub fn heading(column: &str) -> String {
    let (name, unit) = UNITS.iter().find_map(|(end, unit)| Some((column.strip_suffix(end)?, Some(unit)))).unwrap_or((column, None));
    let words: Vec<String> =
        name.split('_').map(|word| if CAPITALS.contains(&word) { word.to_uppercase() } else { word.to_owned() }).collect();
    let mut letters = words.join(" ");
    if let Some(first) = letters.get_mut(..1) {
        first.make_ascii_uppercase();
    }
    unit.map_or(letters.clone(), |unit| format!("{letters}, {unit}"))
}

#[cfg(test)]
mod tests {
    use super::heading;

    #[test]
    fn names_become_words_and_units() {
        let shown = [
            "volume_lv_ml",
            "mean_distance_tracked_mm",
            "pressure_rate_max_mmhg_per_s",
            "dice_tracked",
            "frame",
            "rms",
            "wall_time_s",
            "σ0",
        ];
        let expected = [
            "Volume LV, mL",
            "Mean distance tracked, mm",
            "Pressure rate max, mmHg/s",
            "Dice tracked",
            "Frame",
            "RMS",
            "Wall time, s",
            "σ0",
        ];
        assert_eq!(shown.map(heading), expected);
    }
}
