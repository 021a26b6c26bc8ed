//! Where a live view is served.

use std::str::FromStr;
use std::thread;

use super::Error;
use super::terminal::{announce, note};
use crate::view::live::LiveView;

/// Where a view is served: a name or address of this machine and a port.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Address {
    /// Only this machine sees the view at `127.0.0.1`.
    pub host: String,
    /// 0 takes any free one.
    pub port: u16,
}

impl FromStr for Address {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let (host, port) = text.rsplit_once(':').unwrap_or(("127.0.0.1", text));
        let bare = host.strip_prefix('[').and_then(|h| h.strip_suffix(']')).unwrap_or(host);
        match port.parse() {
            Ok(port) if !bare.is_empty() => Ok(Address { host: bare.to_owned(), port }),
            _ => Err(format!("expected a port or HOST:PORT, found `{text}`")),
        }
    }
}

impl Address {
    /// Opens a view there and says where it is: also when talk is unwanted, nobody finds it otherwise.
    ///
    /// # Errors
    /// When the address is not one of this machine, or taken.
    pub(super) fn open(&self) -> Result<LiveView, Error> {
        let Address { host, port } = self;
        let view = LiveView::open(host, *port)
            .map_err(|e| Error::Input(format!("--view {host}:{port}: {e}")))?;
        announce(format_args!("live view at {}", view.url()));
        Ok(view)
    }
}

/// Keeps a view open until somebody ends the program.
pub(super) fn stay(view: &LiveView) -> ! {
    note(format_args!("the live view stays at {} until Ctrl-C", view.url()));
    loop {
        thread::park();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_on_this_machine_unless_they_say_otherwise() {
        let at = |host: &str, port| Ok(Address { host: host.into(), port });
        assert_eq!("7332".parse(), at("127.0.0.1", 7332));
        assert_eq!("0.0.0.0:80".parse(), at("0.0.0.0", 80));
        assert_eq!("[::1]:0".parse(), at("::1", 0));
        assert_eq!("lab.local:7332".parse(), at("lab.local", 7332));
        for bad in ["", ":7332", "x", "host:", "host:70000", "7332:", "[]:1"] {
            assert!(bad.parse::<Address>().unwrap_err().contains("expected a port"), "{bad}");
        }
    }
}
