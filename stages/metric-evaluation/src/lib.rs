//! metric-evaluation
