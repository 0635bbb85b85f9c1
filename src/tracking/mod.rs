//! The proactive tracker: image forces and block-matched base, \[Billet2009\] §4 and §5.
//!
//! | module | what it holds |
//! |---|---|
//! | `instant` | the cine sequence at one time, linear between frames |
//! | `appearance`, `thickness` | what each surface looks like on the reference frame, and how far its wall reaches |
//! | `boundary` | the search of boundary points Z along the normals |
//! | `scheme` | the image force of one vertex: explicit, published, exact, variational |
//! | `image_force` | all surfaces as one load on the step system |
//! | `block_matching`, `blocks`, `pyramid` | the motion of the base from blocks of voxels |
//! | `carried_blocks`, `tissue_mask`, `proactive_blocks` | the same from blocks that deform with the tissue, and while the heart is tracked |
//! | `base_force`, `wall_force` | the base and the inside of the wall drawn along a known motion |
//! | `force_tangents` | the derivatives of both, for tangents of tracked hearts |
//! | `tracker`, `residuals` | one beat under these loads, and what the images say of it |
//! | `agreement`, `section` | a tracked cavity against an expert's labels |

mod agreement;
mod appearance;
mod base_force;
mod block_matching;
mod blocks;
mod boundary;
mod carried_blocks;
mod error;
#[cfg(test)]
mod fixtures;
mod force_tangents;
mod image_force;
mod instant;
mod proactive_blocks;
mod pyramid;
mod residuals;
mod scheme;
mod section;
mod thickness;
mod tissue_mask;
mod tracker;
mod wall_force;

pub use agreement::{CavityAgreement, SliceAgreement};
pub use appearance::{AppearanceSettings, SurfaceAppearance};
pub use base_force::{BaseForce, BaseMatches, BaseMode, BaseProjection};
pub use block_matching::{BlockMatchingSettings, BlockShape, Similarity, match_base};
pub use boundary::{BoundarySearch, BoundarySettings, BoundaryTarget, SurfaceTargets};
pub use error::TrackingError;
pub use image_force::{ImageForce, SurfaceGain};
pub use instant::{ImageInstant, SliceResolution};
pub use residuals::{SurfaceResidual, TrackedFrame};
pub use scheme::{ForceScheme, VertexLoad};
pub use section::Contour;
pub use tracker::{PhaseWork, TrackedMotion, TrackerSettings, track};
pub use wall_force::WallSettings;
