//! Renders the project's own test bracket, `testdata/window/`: a room on a late afternoon, with a bright window.
//!
//! It uses nothing of hdralign, so that what it says about the pictures (motion, response, radiance) is an independent
//! truth. The line, one file each:
//!
//!     room, furniture, still_life -> scene -> trace -> denoise -> motion -> camera -> truth
//!
//! `room`, `furniture` and `still_life` make triangles ([`mesh`]) with [`paint`] on them; [`outdoors`] is what the window
//! looks out on; [`trace`] is a path tracer over a [`bvh`]; [`motion`] resamples its one large picture for each hand-held
//! frame; [`camera`] exposes, adds noise, and encodes; [`truth`] writes down what is known.
//!
//! Everything random is drawn from counters (pixel, sample), so that the number of threads changes nothing.

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
