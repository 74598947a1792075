//! Procedural triangle meshes, seeded and streamed.
