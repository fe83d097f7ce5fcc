//! File formats: conversion between bytes and values. Every size is checked against the available bytes before
//! memory is allocated, and invalid bytes give a typed error.

pub mod base64;
pub mod believable;
pub mod capture;
pub mod colour_range;
pub mod cube;
mod exif;
pub mod exr;
pub mod foreign;
pub mod gltf;
pub mod gpano;
pub mod hdr;
pub mod head;
pub mod icc;
pub mod import;
pub mod jpeg;
pub mod mesh;
pub mod mesh_format;
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
pub mod surface;
pub mod tiff;
mod tiff_tags;
mod turn;
pub mod webp;
