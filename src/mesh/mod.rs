//! Tetrahedral meshes, their tagged surfaces and the cavities they enclose; knows no voxel.

mod cavity;
mod closed_surface;
mod error;
pub mod io;
mod locate;
mod quality;
mod section;
mod surface;
mod tet_mesh;

pub use cavity::Cavity;
pub use closed_surface::{ClosedSurface, PointLattice};
pub use error::MeshError;
pub use locate::{Location, TetLocator, distance_to_triangle_mm};
pub use quality::MeshQuality;
pub use section::{Contour, section};
pub use surface::{SurfaceTag, TaggedSurface};
pub use tet_mesh::TetMesh;
