//! Hearts whose truth is known: idealised anatomies and synthetic cine, \[Billet2009\] §6.1.

mod error;
mod idealised_lv;
mod imaged_heart;
mod noise;
mod prescribed_motion;
mod random_field;
mod rasterise;
mod scan;
mod short_axis;
mod synthetic_cine;
mod valve_marks;

pub use error::PhantomError;
pub use idealised_lv::IdealisedLv;
pub use noise::breath_hold_shifts_mm;
pub use prescribed_motion::PrescribedContraction;
pub use rasterise::{LABEL_CAVITY_LV, LABEL_CAVITY_RV, LABEL_WALL, TissueShares, VoxelSampling, rasterise};
pub use short_axis::ShortAxisStack;
pub use synthetic_cine::{SyntheticCine, SyntheticCineSettings, synthetic_cine};
pub use valve_marks::marked_valve_ring_mm;
