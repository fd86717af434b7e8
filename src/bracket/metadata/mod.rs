//! What files record beside pixels and exposure: camera, lens and time, and what of it the results carry on.

pub(crate) mod capture;
pub(crate) mod carried;
pub(crate) mod moment;
