//! From cine MRI to a personalised, beating, electromechanical heart.
//!
//! The rooms, in reading order; a room uses the ones above it only:
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
