//! Dense double-precision models: the independent yardstick of the core.
