//! One file per thesis figure or table.
