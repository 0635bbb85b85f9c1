//! Files that are not what they should be, by the thousand: whatever is read may be refused, but nothing panics, hangs or exhausts the memory.
//!
//! Good files of every kind are garbled at random, and read as a user's would be. In the gate a few hundred of each in seconds; for a long run
//!
//! ```sh
//! CARDIOTWIN_GARBLED_FILES=20000 cargo test --release --test any_bytes -- --nocapture
//! ```
//!
//! A file that makes trouble is kept in the folder that the failure names.

#![allow(clippy::unwrap_used, clippy::panic, clippy::print_stderr, reason = "a test may stop at the first surprise, and says what it met")]

mod dicom_slices;

use std::collections::BTreeMap;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use cardiotwin::anatomy::mesher::MesherSettings;
use cardiotwin::anatomy::{AnatomySettings, IdealisedBiventricle};
use cardiotwin::image::{
    CineSequence, CineTiming, Grid, LabelMap, Volume, read_cine, read_dicom_folder, read_label_maps, summarise, write_cine, write_label_map,
};
use cardiotwin::mesh::io::{FieldValues, MeshFile, Numbering, TableFiles, TagCodes, read_mesh_file, read_mesh_tables, write_mesh_file};
use cardiotwin::report::read_parameters;
use cardiotwin::study::{Cohort, Config, CurveSource, DraftInputs, Overrides, Plan, draft_study, measure_volumes};
use dicom_slices::dicom_slice;
use nalgebra::Vector3;
use rand::seq::IndexedRandom;
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// No file of these small ones may take longer; a machine under load is slow.
const PATIENCE: Duration = Duration::from_secs(20);

/// Peak memory of the whole test, kB.
const MEMORY_KB: u64 = 3_000_000;

/// How many garbled files of a kind: what the gate has time for, or as the environment says.
fn count(in_the_gate: usize) -> usize {
    std::env::var("CARDIOTWIN_GARBLED_FILES").ok().and_then(|count| count.parse().ok()).unwrap_or(in_the_gate)
}

/// Numbers that readers tend to take amiss.
const NUMBERS: [&str; 14] = [
    "0",
    "-1",
    "1",
    "nan",
    "inf",
    "-inf",
    "1e308",
    "-1e-308",
    "4294967296",
    "9223372036854775807",
    "99999999999999999999",
    "0.1",
    "",
    "[1]",
];

/// The bytes with one to five things done to them.
fn garbled(whole: &[u8], random: &mut ChaCha8Rng) -> Vec<u8> {
    let mut bytes = whole.to_vec();
    for _ in 0..random.random_range(1..=5) {
        if bytes.is_empty() {
            break;
        }
        let at = random.random_range(0..bytes.len());
        // Headers are short and decide much.
        let at = if random.random() { at } else { at.min(random.random_range(0..bytes.len().min(512))) };
        let end = (at + random.random_range(1..=64)).min(bytes.len());
        match random.random_range(0..8) {
            0 => bytes[at] = random.random(),
            1 => bytes[at] ^= 1 << random.random_range(0..8),
            2 => bytes[at..end].fill(*[0, 0x7f, 0x80, 0xff].choose(random).unwrap()),
            3 => drop(bytes.drain(at..end)),
            4 => {
                let piece = bytes[at..end].to_vec();
                let to = random.random_range(0..bytes.len());
                bytes.splice(to..to, piece);
            }
            5 => bytes.truncate(at),
            _ => replace_number(&mut bytes, at, random),
        }
    }
    bytes
}

/// Another number, in text, in place of the next one from here on.
fn replace_number(bytes: &mut Vec<u8>, from: usize, random: &mut ChaCha8Rng) {
    let is_digit = |byte: &u8| byte.is_ascii_digit() || b"+-.e".contains(byte);
    let Some(start) = bytes[from..].iter().position(u8::is_ascii_digit).map(|place| from + place) else { return };
    let end = bytes[start..].iter().position(|byte| !is_digit(byte)).map_or(bytes.len(), |place| start + place);
    bytes.splice(start..end, NUMBERS.choose(random).unwrap().bytes());
}

/// Garbles files of one kind and has them read; `read` says whether it could.
fn survives(kind: &str, seeds: &[(String, Vec<u8>)], count: usize, mut read: impl FnMut(&Path) -> bool) {
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join("any_bytes").join(kind);
    let _ = std::fs::remove_dir_all(&folder);
    std::fs::create_dir_all(&folder).unwrap();
    let mut random = ChaCha8Rng::seed_from_u64(1909);
    let (mut accepted, mut slowest, started) = (0, Duration::ZERO, Instant::now());
    for (name, whole) in seeds {
        let file = folder.join(name);
        std::fs::write(&file, whole).unwrap();
        assert!(read(&file), "{kind}: {name} was not read as it is");
    }
    for round in 0..count {
        let (name, whole) = seeds.choose(&mut random).unwrap();
        let file = folder.join(name);
        std::fs::write(&file, garbled(whole, &mut random)).unwrap();
        let began = Instant::now();
        let outcome = catch_unwind(AssertUnwindSafe(|| read(&file)));
        let took = began.elapsed();
        let Ok(is_read) = outcome else { panic!("{kind}: garbled file {round} made it panic; it is kept as {}", file.display()) };
        assert!(took < PATIENCE, "{kind}: garbled file {round} took {took:?}; it is kept as {}", file.display());
        accepted += usize::from(is_read);
        slowest = slowest.max(took);
    }
    let memory_kb = peak_memory_kb();
    assert!(memory_kb.is_none_or(|kb| kb < MEMORY_KB), "{kind}: {memory_kb:?} kB");
    eprintln!(
        "{kind}: {count} garbled files in {:.1} s, {accepted} of them still readable, the slowest {} ms, peak memory of the process {} MB",
        started.elapsed().as_secs_f64(),
        slowest.as_millis(),
        memory_kb.unwrap_or(0) / 1000
    );
    std::fs::remove_dir_all(&folder).unwrap();
}

/// Peak resident memory of this process, where the system tells it.
fn peak_memory_kb() -> Option<u64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    status.lines().find_map(|line| line.strip_prefix("VmHWM:"))?.trim().trim_end_matches(" kB").parse().ok()
}

fn text(path: &Path) -> String {
    String::from_utf8_lossy(&std::fs::read(path).unwrap()).into_owned()
}

#[test]
fn study_and_cohort_files() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut seeds = Vec::new();
    for folder in std::fs::read_dir(root.join("studies")).unwrap().map(|entry| entry.unwrap().path()).filter(|path| path.is_dir()) {
        for file in std::fs::read_dir(&folder).unwrap().map(|entry| entry.unwrap().path()) {
            if file.extension().is_some_and(|ending| ending == "toml") {
                let name = format!("{}_{}", folder.file_name().unwrap().to_string_lossy(), file.file_name().unwrap().to_string_lossy());
                seeds.push((name, std::fs::read(&file).unwrap()));
            }
        }
    }
    seeds.sort();
    assert!(seeds.len() > 20, "{}", seeds.len());
    survives("study files", &seeds, count(1500), |path| {
        let whole = text(path);
        // Once as a file, once as settings of the command line.
        let settings = whole.lines().filter(|line| line.contains('=')).take(4).map(str::to_string).collect();
        let _ = Config::from_text(path, whole.clone(), Overrides { settings, ..Overrides::default() }).map(|config| Plan::new(&config));
        let Ok(config) = Config::from_text(path, whole, Overrides::default()) else { return false };
        let (plan, cohort) = (Plan::new(&config), Cohort::new(&config));
        // Data that are not at hand are no fault of the file.
        drop((plan, cohort));
        true
    });
}

#[test]
fn tables() {
    let curve: String = (0..12).map(|n| format!("{},{}\n", 0.06 * f64::from(n), 90.0 + 30.0 * f64::from(n % 7))).collect();
    let curve = format!("time_s,volume_lv_ml\n{curve}").into_bytes();
    let parameters = b"parameter,unit,region,initial,value,lower,upper,sd,interval_low,interval_high,at_bound,state,prior_mean,prior_sd\n\
        contraction_peak_lv_kpa,kPa,heart,90.0,101.5,30.0,200.0,2.5,96.6,,false,free,,\n"
        .to_vec();
    let is_parameters = |path: &Path| path.ends_with("parameters.csv");
    let scratch = tempfile::tempdir().unwrap();
    survives("tables", &[("curve.csv".into(), curve), ("parameters.csv".into(), parameters)], count(60), |path| {
        if is_parameters(path) {
            return read_parameters(path).is_ok();
        }
        measure_volumes(&CurveSource::Table { path: path.into(), period_s: 0.8 }, scratch.path()).is_ok()
    });
}

/// Names of files with what they hold.
type Files = Vec<(String, Vec<u8>)>;

/// A coarse heart of two ventricles as files of every kind, and in plain text.
fn heart_files(folder: &Path) -> (Files, Files) {
    let heart = IdealisedBiventricle::default();
    let anatomy = heart.build(&MesherSettings::with_edge_length_mm(16.0), &AnatomySettings::default()).unwrap();
    let fibres: Vec<Vector3<f64>> = anatomy.fibre_axes.iter().map(|axes| axes.column(0).into_owned()).collect();
    let file = |name: &str| {
        let path = folder.join(name);
        write_mesh_file(&path, &anatomy.mesh, &anatomy.surface, &[], &[("fibre", FieldValues::Vectors(&fibres))]).unwrap();
        (name.to_string(), std::fs::read(path).unwrap())
    };
    let files = ["heart.vtu", "heart.vtk", "heart.msh"].map(file).to_vec();
    let rows = |rows: &mut dyn Iterator<Item = String>| rows.collect::<Vec<_>>().join("\n").into_bytes();
    let vertices = rows(&mut anatomy.mesh.vertices_mm().iter().map(|p| format!("{} {} {}", p.x, p.y, p.z)));
    let tetrahedra = rows(&mut anatomy.mesh.tetrahedra().iter().map(|[a, b, c, d]| format!("{a} {b} {c} {d}")));
    let surface = rows(
        &mut anatomy.surface.triangles().iter().zip(anatomy.surface.tags()).map(|([a, b, c], tag)| format!("{a} {b} {c} {}", tag.code())),
    );
    (files, vec![("vertices.txt".into(), vertices), ("tetrahedra.txt".into(), tetrahedra), ("surface.txt".into(), surface)])
}

/// A mesh file as a heart's mesh with its surface.
fn becomes_a_heart(file: &MeshFile) -> bool {
    [Numbering::Oriented, Numbering::Free].into_iter().any(|numbering| {
        let mesh = file.to_tet_mesh(1.0, numbering);
        mesh.is_ok_and(|mesh| file.to_tagged_surface(&mesh, file.surface_field(), &TagCodes::default()).is_ok())
    })
}

#[test]
fn meshes() {
    let folder = tempfile::tempdir().unwrap();
    let (files, tables) = heart_files(folder.path());
    survives("meshes", &files, count(300), |path| read_mesh_file(path).is_ok_and(|file| becomes_a_heart(&file)));
    survives("mesh tables", &tables, count(100), |path| {
        let place = |name: &str| if path.ends_with(name) { path.to_path_buf() } else { folder.path().join(name) };
        for (name, whole) in &tables {
            std::fs::write(folder.path().join(name), whole).unwrap();
        }
        let files = TableFiles {
            vertices: place("vertices.txt"),
            tetrahedra: place("tetrahedra.txt"),
            surface: place("surface.txt"),
            fibres: None,
        };
        read_mesh_tables(&files).is_ok_and(|file| becomes_a_heart(&file))
    });
}

/// A tube of blood (1) in a wall (2), and six frames that show it.
fn image_files(folder: &Path) -> Files {
    let grid = Grid::axis_aligned([16, 14, 6], Vector3::new(-20.0, -18.0, 5.0), Vector3::new(2.5, 2.5, 8.0)).unwrap();
    let radius_mm = |flat: usize| 2.5 * (grid.voxel_of(flat)[0] as f64 - 7.5).hypot(grid.voxel_of(flat)[1] as f64 - 6.5);
    let label = |flat: usize| if radius_mm(flat) < 8.0 { 1 } else { 2 * u8::from(radius_mm(flat) < 16.0) };
    let labels: Vec<u8> = (0..grid.voxel_count()).map(label).collect();
    let frame = |n: u8| Volume::new(grid.clone(), labels.iter().map(|&label| 60.5 * f32::from(label) + f32::from(n)).collect()).unwrap();
    let cine = CineSequence::new((0..6).map(frame).collect(), (0..6).map(|n| 0.8 * f64::from(n) / 6.0).collect(), 0.8).unwrap();
    let labels = LabelMap::new(grid, labels).unwrap();
    let created = |name: &str, write: &dyn Fn(&mut Vec<u8>)| {
        let mut bytes = Vec::new();
        write(&mut bytes);
        (name.to_string(), bytes)
    };
    let (cine, labels) = (
        created("cine.nii.gz", &|bytes| write_cine(bytes, &cine).unwrap()),
        created("labels.nii.gz", &|bytes| write_label_map(bytes, &labels).unwrap()),
    );
    std::fs::write(folder.join("cine.nii.gz"), &cine.1).unwrap();
    // Without compression, too, where every byte tells.
    let plain = |(name, bytes): &(String, Vec<u8>)| {
        let mut whole = Vec::new();
        std::io::Read::read_to_end(&mut flate2::read::GzDecoder::new(bytes.as_slice()), &mut whole).unwrap();
        (name.trim_end_matches(".gz").to_string(), whole)
    };
    vec![plain(&cine), plain(&labels), cine, labels]
}

#[test]
fn nifti_images() {
    let folder = tempfile::tempdir().unwrap();
    let seeds = image_files(folder.path());
    let cine = folder.path().join("cine.nii.gz");
    survives("NIfTI images", &seeds, count(600), |path| {
        let read = read_cine(path, &CineTiming::default()).is_ok() | read_label_maps(path).is_ok();
        let _ = summarise(path, &CineTiming::default());
        // As `init` looks at it, alone and beside a good cine.
        for files in [vec![path.to_path_buf()], vec![cine.clone(), path.to_path_buf()]] {
            let _ = draft_study(&DraftInputs { files, ..DraftInputs::default() }, &folder.path().join("study.toml"));
        }
        read
    });
}

#[test]
fn dicom_folders() {
    let places = || (0..2_u16).flat_map(|slice| (0..4_u16).map(move |phase| (slice, phase)));
    let seeds: BTreeMap<String, Vec<u8>> =
        places().map(|(slice, phase)| (format!("{slice}_{phase}.dcm"), dicom_slice(slice, phase))).collect();
    let seeds: Vec<(String, Vec<u8>)> = seeds.into_iter().collect();
    let folder = tempfile::tempdir().unwrap();
    survives("DICOM folders", &seeds, count(300), |path: &Path| {
        // One file among its good neighbours.
        for (name, whole) in &seeds {
            std::fs::write(folder.path().join(name), whole).unwrap();
        }
        let place: PathBuf = folder.path().join(path.file_name().unwrap());
        std::fs::copy(path, place).unwrap();
        read_dicom_folder(folder.path(), &CineTiming::default()).is_ok()
    });
}
