//! When each vertex is depolarised: the anisotropic eikonal model, \[Billet2009\] §2.
//!
//! $v^2\,\nabla t_d\cdot D\nabla t_d = 1$ with $D = \mathrm{diag}(1, \rho, \rho)$ in fibre axes: the front runs at $v$ along the
//! fibre and at $v\sqrt\rho$ across it. [`activate`] solves it on linear tetrahedra; the [`ActivationMap`] keeps the stencil every
//! time came from, so that the times can be differentiated in the speeds. [`activate_beats`]
//! does so beat after beat with refractory tissue.

mod activation;
mod conduction;
mod element;
mod error;
mod front;
mod march;
mod ray;
mod rhythm;

pub use activation::{ActivationMap, ActivationSettings, Onset, Stencil, activate, activate_with, nearest_vertex};
pub use conduction::Conduction;
pub use error::ActivationError;
pub use ray::RayLeg;
pub use rhythm::{Rhythm, activate_beats};
