//! Renders the project's own test bracket, `testdata/window/`: a room on a late afternoon, with a bright window.
//!
//! It uses no code of hdralign, so that the motion, response and radiance that it records are an independent truth. The
//! stages, one file each:
//!
//!     room, furniture, still_life -> scene -> trace -> denoise -> motion -> camera -> truth
//!
//! `room`, `furniture` and `still_life` make triangles ([`mesh`]) with a [`paint`]; [`outdoors`] is the landscape
//! outside of the window; [`trace`] is a path tracer that uses a [`bvh`] and renders one large picture; [`motion`]
//! resamples this picture for each hand-held frame; [`camera`] exposes, adds noise, and encodes; [`truth`] records the
//! truth.
//!
//! Random numbers are computed from counters (pixel, sample), so that the result does not depend on the number of
//! threads.

pub mod bvh;
pub mod camera;
pub mod denoise;
pub mod furniture;
pub mod mesh;
pub mod motion;
pub mod noise;
pub mod outdoors;
pub mod paint;
pub mod room;
pub mod scene;
pub mod still_life;
pub mod trace;
pub mod truth;
pub mod vec3;
