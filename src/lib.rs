//! From cine MRI to a personalised, beating, electromechanical heart.
//!
//! # A tour
//!
//! The whole program is [`study`]: the text of a study file ([`study::Config`]) becomes a [`study::Plan`] in which every value is present and every file
//! is found; [`study::run`] does it, tells a [`study::Progress`] how far it is, and leaves its files in a folder.
//!
//! ```
//! use cardiotwin::study::{Config, Overrides, Plan, RunContext, Silent, Status, run};
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! # let folder = std::env::temp_dir().join("cardiotwin_tour");
//! let text = "kind = \"simulate\"\n[anatomy]\nedge_length_mm = 12.0\n[anatomy.idealised_lv]\n[mechanics]\nstep_s = 0.02\n";
//! let overrides = Overrides { output: Some(folder), settings: vec!["output.figures=false".into()], ..Overrides::default() };
//! let plan = Plan::new(&Config::from_text("study.toml".as_ref(), text.into(), overrides)?)?;
//! let outcome = run(&plan, &RunContext::new(&Silent, &false.into()))?;
//! assert_eq!(outcome.status, Status::Converged);
//! # Ok(())
//! # }
//! ```
//!
//! Below it the rooms can be used alone. [`image::read_cine_source`] reads a beat, [`image::heart_fields`] makes smooth surfaces of labels,
//! [`anatomy::build_from_fields`] a mesh with fibres of those ([`anatomy::Anatomy`]); [`heart::HeartModel`] is that heart with [`heart::Parameters`], activated
//! and assembled once, and [`heart::simulate`] beats it, free or under loads of images; [`tracking::track`] lets a cine pull it along.
//!
//! ```
//! use cardiotwin::heart::{Parameter, Parameters};
//! use cardiotwin::image::{CineSequence, Grid, Volume};
//! use nalgebra::Vector3;
//!
//! # fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // Parameters are held within their physical ranges, and know their units and sources.
//! let mut parameters = Parameters::default();
//! parameters.set(Parameter::ContractionPeakLv, 150.0)?;
//! assert!(parameters.set(Parameter::ContractionPeakLv, -1.0).is_err());
//! assert_eq!(Parameter::ContractionPeakLv.spec().unit, "kPa");
//!
//! // Images are sampled in world millimetres at any time of the beat: here x + t, between voxels and frames.
//! let grid = Grid::axis_aligned([4, 4, 4], Vector3::zeros(), Vector3::repeat(2.0))?;
//! let frame = |n: usize| Volume::new(grid.clone(), (0..64).map(|flat| 2.0 * grid.voxel_of(flat)[0] as f32 + n as f32).collect());
//! let cine = CineSequence::new(vec![frame(0)?, frame(1)?], vec![0.0, 0.4], 0.8)?;
//! let value = cine.at_time(0.2).sample(&Vector3::new(3.0, 3.0, 3.0)).ok_or("outside")?;
//! assert!((value - 3.5).abs() < 1e-6);
//! # Ok(())
//! # }
//! ```
//!
//! `examples/` has a program of its own for each: `simulate_beat`, `read_cine`, `build_mesh`, `personalise`.
//!
//! Everywhere: positions are `nalgebra::Vector3<f64>` in world mm (RAS), units are the last part of every name, ventricles come left first, and what does not
//! work is an error that says what, where and how much.
//!
//! # The rooms
//!
//! In reading order; a room uses the ones above it only:
//!
//! | room | what it holds |
//! |---|---|
//! | [`units`] | mm, s, kg and every conversion at the edge |
//! | [`numerics`] | block-sparse matrices, factorisation, quadratic programs, statistics |
//! | [`image`] | voxels in world mm: volumes, cine sequences, masks, volume curves |
//! | [`mesh`] | tetrahedra: meshes, tagged surfaces, cavities, quality, files |
//! | [`anatomy`] | the heart at rest: masks → mesh, regions, transmural depth, fibres |
//! | [`electrophysiology`] | the anisotropic eikonal activation map |
//! | [`mechanics`] | linear visco-elasticity, active stress, springs, the step system and its loads |
//! | [`circulation`] | Windkessels, atria, valves as one complementarity problem |
//! | [`heart`] | parameters, the coupled step, the beat, observables |
//! | [`tracking`] | image forces, block matching at the base, the tracker |
//! | [`phantom`] | hearts whose truth is known: idealised anatomy, synthetic cine |
//! | [`sensitivity`] | which parameters matter: tangents, Morris screening, Sobol' indices |
//! | [`personalisation`] | residuals, Gauss–Newton with constrained QP steps, gains, uncertainty |
//! | [`report`] | CSV, JSON, VTU and PNG writers |
//! | [`study`] | a TOML file → a plan → results |
//! | [`cli`] | arguments, progress, messages, exit codes |

#![forbid(unsafe_code)]

pub mod units;

pub mod numerics;

pub mod image;
pub mod mesh;

pub mod anatomy;

pub mod circulation;
pub mod electrophysiology;
pub mod mechanics;

pub mod heart;

pub mod phantom;
pub mod tracking;

pub mod sensitivity;

pub mod personalisation;

pub mod report;

pub mod study;

pub mod cli;
