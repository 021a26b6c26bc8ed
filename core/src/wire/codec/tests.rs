//! The stream: what is damaged, lost, doubled or late, and that the place in it is found again.

use std::format;
use std::vec::Vec;

use proptest::prelude::*;

use super::super::*;
use crate::space::{Planar, Spatial};
use messages::{HELLO, contact};

mod messages;

fn wire<M: serde::Serialize>(sequence: u8, time: u32, message: M) -> Vec<u8> {
    let mut buffer = [0; MAX_FRAME];
    encode(&Frame { sequence, time: Clock(time), message }, &mut buffer).unwrap().to_vec()
}

fn decode_all<M: serde::de::DeserializeOwned + core::fmt::Debug>(
    bytes: &[u8],
) -> (Decoder<M>, Vec<Result<Received<M>, FrameError>>) {
    let mut decoder = Decoder::new();
    let frames: Vec<_> = bytes.iter().filter_map(|&b| decoder.push(b)).collect();
    // Many at once are as one by one, wherever they are cut.
    let mut many = Decoder::<M>::new();
    let mut again = Vec::new();
    for mut piece in bytes.chunks(7) {
        while !piece.is_empty() {
            let (frame, rest) = many.take(piece);
            again.extend(frame);
            piece = rest;
        }
    }
    // As text, in which a NaN equals itself.
    assert_eq!(format!("{again:?}"), format!("{frames:?}"));
    assert_eq!(many.counters(), decoder.counters());
    assert_eq!(many.is_inside_frame(), decoder.is_inside_frame());
    (decoder, frames)
}

#[test]
fn another_version_is_named() {
    let mut hello = HELLO;
    hello.protocol = 200;
    let (decoder, frames) =
        decode_all::<Report<Planar>>(&wire(3, 0, Report::<Planar>::Hello(hello)));
    assert_eq!(frames, [Err(FrameError::Version { theirs: 200, sequence: 3 })]);
    assert_eq!(decoder.counters().version, 1);
    let message = format!("{}", FrameError::Version { theirs: 200, sequence: 3 });
    assert!(message.contains("200") && message.contains(&format!("{PROTOCOL}")), "{message}");
    // Even when the rest of that version's message is unlike ours.
    let mut out = [0; 64];
    let sealed = seal(&[3, 0, 0, 0, 0, 0, 200, 1, 2, 3], &mut out).unwrap();
    let (_, frames) = decode_all::<Report<Planar>>(sealed);
    assert_eq!(frames, [Err(FrameError::Version { theirs: 200, sequence: 3 })]);
    // Its number in more bytes than it needs is none.
    let sealed = seal(&[3, 0, 0, 0, 0, 0x80, 0, 200], &mut out).unwrap();
    let (_, frames) = decode_all::<Command<Planar>>(sealed);
    assert_eq!(frames, [Err(FrameError::Malformed)]);
}

#[test]
fn wrong_payloads_are_told_apart() {
    let mut out = [0; 400];
    let cases: [(&[u8], FrameError); 5] = [
        (&[1, 0, 0, 0, 0, 99], FrameError::Malformed),
        (&[1, 0, 0], FrameError::Malformed),
        (&[], FrameError::Malformed),
        (&[1, 0, 0, 0, 0, 1, 7], FrameError::Trailing),
        (&[7; 200], FrameError::Oversize),
    ];
    for (payload, error) in cases {
        let (decoder, frames) = decode_all::<Command<Planar>>(seal(payload, &mut out).unwrap());
        assert_eq!(frames, [Err(error)], "{payload:?}");
        assert_eq!(decoder.counters().damaged(), 1);
    }
    let (_, frames) = decode_all::<Command<Planar>>(&[9, 1, 0, 1, 0, 0, 0]);
    assert_eq!(frames, [Err(FrameError::Cobs), Err(FrameError::Crc)]);
}

#[test]
fn sequences_are_followed() {
    let ping = |n: u8| wire(n, 0, Command::<Planar>::Ping);
    let order = [250u8, 251, 251, 253, 252, 0, 254, 255, 251, 128, 127];
    let bytes: Vec<u8> = order.iter().flat_map(|&n| ping(n)).collect();
    let (decoder, frames) = decode_all::<Command<Planar>>(&bytes);
    use Arrival::{Doubled, Late, New};
    let arrivals: Vec<_> = frames.into_iter().map(|f| f.unwrap().arrival).collect();
    let want = [New, New, Doubled, New, Late, New, Late, Late, Doubled, New, Late];
    assert_eq!(arrivals, want);
    let c = decoder.counters();
    assert_eq!((c.frames, c.doubled, c.late), (11, 2, 4));
    // From 0 to 128 jumps over 127 numbers, of which one came late.
    assert_eq!(c.lost, 126);
}

#[test]
fn hello_starts_anew_at_any_number() {
    let mut bytes = wire(100, 0, Command::<Planar>::Ping);
    bytes.extend(wire(3, 0, Command::<Planar>::Hello { protocol: PROTOCOL }));
    bytes.extend(wire(4, 0, Command::<Planar>::Ping));
    let (decoder, frames) = decode_all::<Command<Planar>>(&bytes);
    assert!(frames.iter().all(|f| f.as_ref().unwrap().arrival == Arrival::New));
    assert_eq!(decoder.counters().lost, 0);
}

/// What a line can do to a frame.
#[derive(Clone, Debug)]
enum Mishap {
    None,
    Drop,
    Double,
    Truncate(usize),
    Corrupt(usize, u8),
    Noise(Vec<u8>),
}

fn mishap() -> impl Strategy<Value = Mishap> {
    prop_oneof![
        3 => Just(Mishap::None),
        1 => Just(Mishap::Drop),
        1 => Just(Mishap::Double),
        1 => (0usize..28).prop_map(Mishap::Truncate),
        1 => (0usize..28, 1u8..).prop_map(|(at, bits)| Mishap::Corrupt(at, bits)),
        1 => proptest::collection::vec(any::<u8>(), 0..400).prop_map(Mishap::Noise),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn stuffing_is_undone(payload in proptest::collection::vec(prop_oneof![Just(0u8), any::<u8>(), Just(1)], 0..700)) {
        let mut out = std::vec![0; payload.len() + 12];
        let sealed = seal(&payload, &mut out).unwrap().to_vec();
        let (delimiter, body) = sealed.split_last().unwrap();
        prop_assert_eq!(*delimiter, 0);
        prop_assert!(!body.contains(&0));
        let mut body = body.to_vec();
        prop_assert_eq!(unseal(&mut body).unwrap(), &payload[..]);
    }

    #[test]
    fn random_bytes_never_panic(bytes in proptest::collection::vec(prop_oneof![1 => Just(0u8), 9 => any::<u8>()], 0..2000)) {
        decode_all::<Command<Spatial>>(&bytes);
        decode_all::<Report<Planar>>(&bytes);
        let mut copy = bytes.clone();
        let _ = unseal(&mut copy);
    }

    #[test]
    fn random_payloads_never_panic(payload in proptest::collection::vec(any::<u8>(), 0..140), tag in 0u8..18) {
        let mut payload = payload;
        if let Some(t) = payload.get_mut(5) { *t = tag; }
        let mut out = [0; MAX_FRAME];
        if let Some(sealed) = seal(&payload, &mut out) {
            decode_all::<Command<Spatial>>(sealed);
            decode_all::<Command<Planar>>(sealed);
            decode_all::<Report<Spatial>>(sealed);
            decode_all::<Report<Planar>>(sealed);
        }
    }

    #[test]
    fn good_frames_after_a_mishap_are_recovered(mishaps in proptest::collection::vec(mishap(), 1..60)) {
        // After any mishap one delimiter resynchronises, as a sender that repeats itself sends.
        let (mut bytes, mut whole, mut doubled) = (Vec::new(), Vec::new(), 0);
        for (i, mishap) in mishaps.iter().enumerate() {
            let frame = wire(i as u8, i as u32, Command::Contact(ContactFrame::new(&contact(), 0.1)));
            match mishap {
                Mishap::None => { bytes.extend(&frame); whole.push(i as u8); }
                Mishap::Drop => {}
                Mishap::Double => {
                    bytes.extend(&frame);
                    bytes.extend(&frame);
                    whole.push(i as u8);
                    whole.push(i as u8);
                    doubled += 1;
                }
                Mishap::Truncate(n) => { bytes.extend(&frame[..(*n).min(frame.len() - 2)]); bytes.push(0); }
                Mishap::Corrupt(at, bits) => {
                    let mut frame = frame;
                    let at = at % frame.len();
                    frame[at] ^= bits;
                    bytes.extend(frame);
                    bytes.push(0);
                }
                Mishap::Noise(noise) => {
                    bytes.extend(noise);
                    bytes.push(0);
                    bytes.extend(&frame);
                    whole.push(i as u8);
                }
            }
        }
        let (decoder, frames) = decode_all::<Command<Spatial>>(&bytes);
        let good: Vec<u8> = frames.iter().flatten().map(|f| f.frame.sequence).collect();
        prop_assert_eq!(good, whole);
        prop_assert_eq!(decoder.counters().doubled, doubled);
        prop_assert!(!decoder.is_inside_frame());
    }
}
