//! Rays to picture: tracing of pages, light, materials, tiles, film.
