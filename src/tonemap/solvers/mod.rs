//! What operators compute with: the equations of Poisson and of quadratic forms, the bilateral grid, and how the eye responds to light.
//!
//! In and out: see each; none has options of its own.

pub(crate) mod bilateral;
pub(crate) mod brightness;
pub(crate) mod eye;
pub(crate) mod log_range;
pub(crate) mod poisson;
pub(crate) mod quadratic;
