//! Solvers of the operators, some of them shared: Poisson equation, quadratic program, bilateral grid, models of human
//! vision, range and brightness of the display.
//!
//! In and out: see each module. None has settings of its own.

pub(crate) mod bilateral;
pub(crate) mod brightness;
pub(crate) mod eye;
pub(crate) mod log_range;
pub(crate) mod poisson;
pub(crate) mod quadratic;
