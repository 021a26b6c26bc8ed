//! Bytes to and from a board.
