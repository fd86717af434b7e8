//! Sections of the page, each as HTML.

pub(super) mod advice;
pub(super) mod light;
pub(super) mod photographs;
pub(super) mod scene;
pub(super) mod summary;
pub(super) mod viewer;
pub(super) mod words;
