//! sfm-import
