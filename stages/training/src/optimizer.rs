//! The tensors that learn, their moments, and the rows that come and go.
