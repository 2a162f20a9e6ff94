//! Images for flight computers: to those that ask, chunk by chunk on their own connection ([`fn@serve`]); and whole to those that speak the
//! legacy dialect, as the program that flew sent them ([`LegacyImages`]). Both take them from the [`Gallery`] of what is kept.

mod gallery;
mod legacy;
mod serve;

pub use gallery::Gallery;
pub use legacy::LegacyImages;
pub use serve::{Requests, serve};
