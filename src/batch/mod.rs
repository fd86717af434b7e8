//! A night's worth of brackets: folders in, every bracket of them merged.
//!
//! In: folders as they come from a card. Out: the brackets in them. Cost: see the parts.

pub mod find;

pub use find::{FindOptions, Found, FoundBracket, LeftOver, Reason, Shot, find};
