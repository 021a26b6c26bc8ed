//! The board's behaviour, bytes in and bytes out.
