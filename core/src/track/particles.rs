//! (to be written by the core's author)
