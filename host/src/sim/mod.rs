//! Simulated objects, hands and noise.
