//! Tetrahedral meshes, their tagged surfaces and the cavities they enclose; knows no voxel.

mod cavity;
mod error;
pub mod io;
mod quality;
mod surface;
mod tet_mesh;

pub use cavity::Cavity;
pub use error::MeshError;
pub use quality::MeshQuality;
pub use surface::{SurfaceTag, TaggedSurface};
pub use tet_mesh::TetMesh;
