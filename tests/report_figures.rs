//! Every figure, drawn from made-up data into the target's temporary folder, decoded again, and bad input refused.

#![allow(clippy::unwrap_used, reason = "a test may stop at the first surprise")]

use std::f64::consts::PI;
use std::path::{Path, PathBuf};

use cardiotwin::report::ReportError;
use cardiotwin::report::figures::*;

fn place(name: &str) -> PathBuf {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("figures");
    std::fs::create_dir_all(&folder).unwrap();
    let file = folder.join(name);
    let _ = std::fs::remove_file(&file);
    file
}

/// Size of the picture and the number of its colours, which a blank page has few of.
fn looked_at(file: &Path) -> ((u32, u32), usize) {
    let picture = image::open(file).unwrap().to_rgb8();
    let colours: std::collections::BTreeSet<_> = picture.pixels().map(|pixel| pixel.0).collect();
    (picture.dimensions(), colours.len())
}

/// A volume that empties and fills once.
fn volume_ml(phase: f64, stroke_ml: f64) -> f64 {
    let ejected = if phase < 0.42 { 0.5 - 0.5 * (PI * phase / 0.42).cos() } else { 0.5 + 0.5 * (PI * (phase - 0.42) / 0.58).cos() };
    242.0 - stroke_ml * ejected
}

fn times(count: usize, period_s: f64) -> Vec<f64> {
    (0..count).map(|n| n as f64 * period_s / count as f64).collect()
}

fn curve(name: &str, look: Look, count: usize, value: impl Fn(f64) -> f64) -> Curve {
    let times = times(count, 0.705);
    let values: Vec<f64> = times.iter().map(|t| value(t / 0.705)).collect();
    Curve::new(name, look, &times, &values)
}

#[test]
fn volume_curves_are_drawn() {
    let file = place("volume_curves.png");
    let figure = VolumeCurves {
        title: "Volume of the left ventricle".into(),
        quantity: "LV volume".into(),
        curves: vec![
            curve("model at the start values", Look::Initial, 140, |p| volume_ml(p, 95.0) - 3.0),
            curve("personalised model", Look::Simulated, 140, |p| volume_ml(p, 61.0)),
            curve("tracked", Look::Tracked, 20, |p| volume_ml(p, 60.0) + 2.0 * (20.0 * p).sin()),
            curve("measured in the images", Look::Measured, 20, |p| volume_ml(p, 62.0) + 3.0 * (31.0 * p).cos()),
        ],
    };
    volume_curves(&file, &figure).unwrap();
    let (size, colours) = looked_at(&file);
    assert_eq!(size, (1500, 950));
    assert!(colours > 50, "{colours} colours");
}

#[test]
fn pressures_and_volume_are_drawn_over_their_phases() {
    let file = place("beat.png");
    let pressure = |p: f64| 1.2 + 13.0 * (-(((p - 0.22) / 0.12).powi(2)).powi(2)).exp();
    let band = |name: &str, from_s: f64, to_s: f64| TimeBand { name: name.into(), from_s, to_s };
    let figure = BeatCurves {
        title: "The left ventricle over the beat".into(),
        volume: curve("LV volume", Look::Simulated, 300, |p| volume_ml(p, 60.0)),
        pressures: vec![
            curve("aorta", Look::Artery, 300, |p| 10.5 + 2.5 * (-((p - 0.27) / 0.16).powi(2)).exp()),
            curve("left ventricle", Look::Simulated, 300, pressure),
            curve("left atrium", Look::Other, 300, |p| 1.2 + 0.5 * (-((p - 0.97) / 0.04).powi(2)).exp()),
        ],
        phases: vec![band("IVC", 0.03, 0.07), band("ejection", 0.07, 0.25), band("IVR", 0.25, 0.32), band("filling", 0.32, 0.71)],
    };
    beat_curves(&file, &figure).unwrap();
    assert_eq!(looked_at(&file).0, (1500, 1350));
}

#[test]
fn strains_are_drawn_by_wall() {
    let file = place("strains.png");
    let shortening = |depth: f64, late: f64| move |p: f64| -depth * (-((p - 0.35 - late) / 0.18).powi(2)).exp();
    let panel = |direction: &str, depth: f64| StrainPanel {
        direction: direction.into(),
        curves: vec![
            curve("septum", Look::Septum, 60, shortening(depth, 0.0)),
            curve("septum", Look::Septum, 60, shortening(0.9 * depth, 0.01)),
            curve("lateral", Look::Lateral, 60, shortening(1.1 * depth, 0.05)),
        ],
    };
    let panels = vec![panel("circumferential", 0.2), panel("longitudinal", 0.15), panel("radial", -0.35)];
    strain_curves(&file, &StrainCurves { title: "Strain".into(), panels }).unwrap();
    assert_eq!(looked_at(&file).0, (1300, 150 + 3 * 420));
}

#[test]
fn a_surface_is_drawn_in_bands_with_its_scale() {
    let file = place("surface.png");
    let (rings, sectors) = (30, 60);
    let vertex = |ring: usize, sector: usize| {
        let (polar, around) = (0.5 * PI + 0.5 * PI * ring as f64 / rings as f64, 2.0 * PI * sector as f64 / sectors as f64);
        nalgebra::Vector3::new(30.0 * polar.sin() * around.cos(), 30.0 * polar.sin() * around.sin(), 60.0 * polar.cos())
    };
    let vertices_mm: Vec<_> = (0..=rings).flat_map(|ring| (0..sectors).map(move |sector| vertex(ring, sector))).collect();
    let at = |ring: usize, sector: usize| ring * sectors + sector % sectors;
    let square = |ring: usize, sector: usize| {
        let [a, b, c, d] = [at(ring, sector), at(ring, sector + 1), at(ring + 1, sector + 1), at(ring + 1, sector)];
        [[a, b, c], [a, c, d]]
    };
    let triangles = (0..rings).flat_map(|ring| (0..sectors).flat_map(move |sector| square(ring, sector))).collect();
    let values = vertices_mm.iter().map(|p| (p - nalgebra::Vector3::new(0.0, -25.0, -20.0)).norm()).collect();
    let view = |name: &str, sign: f64| SurfaceView {
        name: name.into(),
        to_eye: nalgebra::Vector3::new(0.0, sign, 0.4),
        up: nalgebra::Vector3::z(),
    };
    let (title, quantity) = ("Activation".into(), "depolarisation time (ms)".into());
    let figure =
        SurfaceMap { title, quantity, vertices_mm, triangles, values, band: 10.0, views: vec![view("front", -1.0), view("back", 1.0)] };
    surface_map(&file, &figure).unwrap();
    let (size, colours) = looked_at(&file);
    assert!(size == (1470, 810) && colours > 200, "{size:?}, {colours} colours");
}

#[test]
fn a_loop_is_drawn_with_both_units() {
    let file = place("pressure_volume_loop.png");
    let around = |grow: f64| -> Vec<(f64, f64)> {
        let corner =
            |t: f64| (211.0 + grow * 31.0 * ((2.0 * PI * t).cos() * 1.25).tanh() / 0.85, 6.5 + 5.5 * ((2.0 * PI * t).sin() * 2.0).tanh());
        (0..=200).map(|n| corner(f64::from(n) / 200.0)).collect()
    };
    let figure = PressureVolumeLoop {
        title: "Pressure–volume loop".into(),
        ventricle: "LV".into(),
        loops: vec![
            Curve { name: "start values".into(), look: Look::Initial, points: around(1.5) },
            Curve { name: "personalised".into(), look: Look::Simulated, points: around(1.0) },
        ],
        points: vec![
            LoopPoint { name: "end of diastole".into(), volume_ml: 242.0, pressure_kpa: 2.2 },
            LoopPoint { name: "end of systole".into(), volume_ml: 181.0, pressure_kpa: 10.0 },
        ],
    };
    pressure_volume_loop(&file, &figure).unwrap();
    assert_eq!(looked_at(&file).0, (1150, 1000));
}

#[test]
fn parameters_are_drawn_on_the_scale_of_their_bounds() {
    let file = place("parameters.png");
    let row = |name: &str, unit: &str, bounds: (f64, f64), initial, value, interval, truth| ParameterInterval {
        name: name.into(),
        unit: unit.into(),
        lower: bounds.0,
        upper: bounds.1,
        initial,
        value,
        interval,
        truth,
    };
    let rows = [
        row("peak contraction LV", "kPa", (30.0, 200.0), 90.0, 104.2, Some((98.0, 110.4)), Some(105.0)),
        row("action potential duration", "s", (0.2, 0.45), 0.3, 0.276, Some((0.268, 0.284)), Some(0.28)),
        row("conduction velocity", "mm/s", (200.0, 1200.0), 500.0, 655.0, Some((480.0, 830.0)), Some(600.0)),
        row("image gain, endocardium LV", "kPa/mm", (0.0, 5.0), 1.0, 5.0, None, None),
    ];
    parameter_intervals(&file, "Parameters found, between their bounds", &rows).unwrap();
    assert_eq!(looked_at(&file).0, (15 * 26 + 70 + 610 + 260, 578));
}

#[test]
fn cost_is_drawn_on_a_logarithmic_axis() {
    let file = place("cost.png");
    let figure = CostHistory { title: "Cost of the search".into(), cost: vec![2400.0, 610.0, 122.0, 61.0, 55.2, 54.9, 54.88] };
    cost_over_iterations(&file, &figure).unwrap();
    assert_eq!(looked_at(&file).0, (1200, 800));
}

/// A ring of muscle in a chest, seen at a time of the beat.
fn panel(height: f64, phase: f64) -> MontagePanel {
    let (columns, rows, spacing) = (72, 64, 1.37);
    let inner = 12.0 * height * (1.0 - 0.3 * (PI * phase).sin());
    let outer = (inner * inner + 560.0 * height).sqrt();
    let origin_mm = [-(columns as f64) * spacing / 2.0 + 6.0, -(rows as f64) * spacing / 2.0];
    let intensity = (0..columns * rows)
        .map(|n| {
            let (x, y) = (origin_mm[0] + (n % columns) as f64 * spacing, origin_mm[1] + (n / columns) as f64 * spacing);
            let (r, right) = (x.hypot(y), (x + 34.0).hypot(1.2 * y));
            let edge = |distance: f64| 1.0 / (1.0 + (-1.3 * distance).exp());
            let muscle = 70.0 + 10.0 * (0.9 * x).sin() * (0.7 * y).cos();
            let around = 30.0 + 140.0 * edge(20.0 - right);
            let body = around * edge(r - outer) + muscle * (1.0 - edge(r - outer));
            body * edge(r - inner) + 210.0 * (1.0 - edge(r - inner))
        })
        .collect();
    let circle = |surface, radius: f64| Contour {
        surface,
        points_mm: (0..=60).map(|n| [radius * (PI * f64::from(n) / 30.0).cos(), radius * (PI * f64::from(n) / 30.0).sin()]).collect(),
    };
    MontagePanel { columns, rows, intensity, origin_mm, spacing_mm: [spacing; 2], contours: vec![circle(0, inner), circle(1, outer)] }
}

#[test]
fn slices_are_drawn_with_their_contours() {
    let file = place("slice_montage.png");
    let times_ms = [0, 71, 141, 247, 388, 564];
    let heights = [1.2, 1.0, 0.8];
    let panels = heights.iter().flat_map(|&height| times_ms.iter().map(move |&t| panel(height, f64::from(t) / 564.0))).collect();
    let figure = Montage {
        title: "Tracked motion on the short-axis images".into(),
        surfaces: vec!["LV endocardium".into(), "epicardium".into()],
        column_titles: times_ms.iter().map(|t| format!("{t} ms")).collect(),
        row_titles: vec!["basal".into(), "middle".into(), "apical".into()],
        panels,
        window: (0.0, 255.0),
    };
    slice_montage(&file, &figure).unwrap();
    let (size, colours) = looked_at(&file);
    assert_eq!(size, (56 + 6 * 276 + 6, 148 + 3 * 246 + 6));
    assert!(colours > 200, "{colours} colours");
}

#[test]
fn empty_and_impossible_input_is_drawn_or_refused_and_never_panics() {
    let nothing = Curve::new("nothing", Look::Simulated, &[], &[]);
    let gaps = Curve::new("gaps", Look::Tracked, &[0.0, f64::NAN, 0.2], &[f64::INFINITY, 1.0, 1.0]);
    let figure = VolumeCurves { title: String::new(), quantity: "V".into(), curves: vec![nothing.clone(), gaps.clone()] };
    volume_curves(&place("empty_volume.png"), &figure).unwrap();
    let empty_loop = PressureVolumeLoop { title: String::new(), ventricle: "LV".into(), loops: vec![nothing, gaps], points: vec![] };
    pressure_volume_loop(&place("empty_loop.png"), &empty_loop).unwrap();
    cost_over_iterations(&place("empty_cost.png"), &CostHistory { title: String::new(), cost: vec![0.0, f64::NAN] }).unwrap();
    parameter_intervals(&place("empty_parameters.png"), "", &[]).unwrap();
    let montage =
        Montage { title: String::new(), surfaces: vec![], column_titles: vec![], row_titles: vec![], panels: vec![], window: (0.0, 1.0) };
    assert!(matches!(slice_montage(&place("empty_montage.png"), &montage), Err(ReportError::Figure { .. })));
    let figure = CostHistory { title: String::new(), cost: vec![1.0] };
    assert!(matches!(cost_over_iterations(Path::new("no/such/folder/cost.png"), &figure), Err(ReportError::Write { .. })));
}

/// A grid that breaks shows another picture than one that does not, and cells that were not tried are drawn too.
#[test]
fn a_sweep_shows_what_broke() {
    let grid = |broken: bool| {
        let cell = |n: usize| if broken && n > 3 { SweepCell::BrokeAfterMs(565.0) } else { SweepCell::Result(2.3 + n as f64) };
        (String::from("explicit"), (0..6).map(cell).chain([SweepCell::Untried; 2]).collect::<Vec<_>>())
    };
    let figure = |broken| Sweep {
        title: "Mean RMSE (mm)".into(),
        column_quantity: "step (ms)".into(),
        row_quantity: "gain (kPa/mm)".into(),
        columns: ["1", "2", "5", "10"].map(String::from).to_vec(),
        rows: ["0.1", "1"].map(String::from).to_vec(),
        grids: vec![grid(broken), grid(false)],
    };
    let drawn = [true, false].map(|broken| {
        let file = place(&format!("sweep_{broken}.png"));
        sweep(&file, &figure(broken)).unwrap();
        let (size, colours) = looked_at(&file);
        assert!(size.0 > 700 && size.1 > 300 && colours > 20, "{size:?} {colours}");
        std::fs::read(file).unwrap()
    });
    assert_ne!(drawn[0], drawn[1]);
}
