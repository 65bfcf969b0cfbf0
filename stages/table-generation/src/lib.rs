//! table-generation
