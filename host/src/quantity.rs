//! Quantities with units, as the command line takes them.
