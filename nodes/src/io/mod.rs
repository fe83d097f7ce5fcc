//! File formats: conversion between bytes and values. Every size is checked against the available bytes before
//! memory is allocated, and invalid bytes give a typed error.

pub(crate) mod base64;
pub(crate) mod capture;
pub(crate) mod colour_range;
pub mod cube;
mod exif;
pub mod exr;
pub(crate) mod foreign;
pub mod gltf;
pub mod gpano;
pub mod hdr;
pub mod head;
pub mod icc;
pub(crate) mod import;
pub mod jpeg;
pub mod mesh;
pub(crate) mod mesh_format;
pub mod picture;
pub mod ply;
pub mod png;
mod png_pack;
pub mod progress;
pub mod quantise;
mod raster;
pub mod recipe;
pub mod source_colour;
pub mod splats;
pub(crate) mod surface;
pub mod webp;
