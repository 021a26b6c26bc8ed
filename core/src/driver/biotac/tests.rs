use std::vec;
use std::vec::Vec;

use embedded_hal::spi::ErrorKind;
use embedded_hal_mock::eh1::delay::{CheckedDelay, NoopDelay, Transaction as Pause};
use embedded_hal_mock::eh1::spi::{Mock, Transaction};
use proptest::prelude::*;

use super::*;
use crate::driver::emulated::{BioTacChip, Fault};

/// What goes over the bus for one sample.
fn sampled(command: [u8; 2], answer: [u8; 2]) -> Vec<Transaction<u8>> {
    vec![
        Transaction::transaction_start(),
        Transaction::write_vec(command.to_vec()),
        Transaction::transaction_end(),
        Transaction::transaction_start(),
        Transaction::transfer_in_place(vec![0, 0], answer.to_vec()),
        Transaction::transaction_end(),
    ]
}

/// The manufacturer's table: PAC, PDC, TAC, TDC, then E1 to E19.
const TABLE: [u8; 23] = [
    0x80, 0x83, 0x85, 0x86, 0xa2, 0xa4, 0xa7, 0xa8, 0xab, 0xad, 0xae, 0xb0, 0xb3, 0xb5, 0xb6, 0xb9,
    0xba, 0xbc, 0xbf, 0xc1, 0xc2, 0xc4, 0xc7,
];

fn example() -> Frame {
    Frame {
        electrodes: core::array::from_fn(|i| 2893 + i as u16),
        pac: core::array::from_fn(|i| 2000 + 7 * i as u16),
        pdc: 4095,
        tac: 0,
        tdc: 1365,
    }
}

#[test]
fn commands_are_those_of_the_manufacturers_table() {
    let fixed = [Channel::Pac, Channel::Pdc, Channel::Tac, Channel::Tdc];
    let channels = fixed.into_iter().chain((0..19).map(Channel::Electrode));
    assert!(channels.map(Channel::command).eq(TABLE.map(|byte| [byte, 0x01])));
}

#[test]
fn values_are_packed_as_on_the_wire() {
    // 0b1011010_01101: bytes 1011010p and 01101xxp.
    assert_eq!(encode(0b1011_0100_1101), [0b1011_0101, 0b0110_1000]);
    assert_eq!(decode([0b1011_0101, 0b0110_1000]), Some(0b1011_0100_1101));
    assert_eq!(decode([0b1011_0100, 0b0110_1000]), None);
    assert_eq!(decode([0b1011_0101, 0b0110_1001]), None);
}

#[test]
fn a_frame_is_forty_four_exact_transactions() {
    let want = example();
    let order = (0..44).map(|slot| match slot {
        odd if odd % 2 == 1 => TABLE[0],
        38 => TABLE[1],
        40 => TABLE[2],
        42 => TABLE[3],
        electrode => TABLE[4 + electrode / 2],
    });
    let values = [
        2893, 2000, 2894, 2007, 2895, 2014, 2896, 2021, 2897, 2028, 2898, 2035, 2899, 2042, 2900,
        2049, 2901, 2056, 2902, 2063, 2903, 2070, 2904, 2077, 2905, 2084, 2906, 2091, 2907, 2098,
        2908, 2105, 2909, 2112, 2910, 2119, 2911, 2126, 4095, 2133, 0, 2140, 1365, 2147,
    ];
    let bus: Vec<_> =
        order.zip(values).flat_map(|(command, v)| sampled([command, 0x01], encode(v))).collect();
    let pauses: Vec<_> = (0..44).flat_map(|_| [Pause::delay_us(50), Pause::delay_us(10)]).collect();
    let (mut spi, mut delay) = (Mock::new(&bus), CheckedDelay::new(&pauses));
    let mut sensor = BioTac::new(spi.clone(), delay.clone());
    assert_eq!(sensor.sample(), Ok(want));
    spi.done();
    delay.done();
    for slot in 0..44 {
        assert_eq!(want.slot(slot), values[slot]);
    }
}

#[test]
fn a_bad_byte_drops_the_frame_and_names_its_slot() {
    let [high, low] = encode(2893);
    let good = sampled([0xa2, 0x01], [high, low]);
    let bad = sampled([0x80, 0x01], [high, low ^ 0x40]);
    let bus = [good.clone(), bad, good].concat();
    let mut spi = Mock::new(&bus);
    let mut sensor = BioTac::new(spi.clone(), NoopDelay::new());
    assert_eq!(sensor.sample(), Err(DriverError::Parity { slot: 1 }));
    // The next slot is the first of a new frame.
    assert_eq!(sensor.poll(), Ok(None));
    spi.done();
}

#[test]
fn nobody_is_told_from_a_bad_byte() {
    for silence in [[0, 0], [0xff, 0xff]] {
        let mut spi = Mock::new(&sampled([0x86, 0x01], silence));
        let mut sensor = BioTac::new(spi.clone(), NoopDelay::new());
        assert_eq!(sensor.start(), Err(DriverError::Missing));
        spi.done();
    }
}

#[test]
fn a_bus_that_fails_is_named() {
    let mut sensor = BioTac::new(crate::driver::tests::Broken, NoopDelay::new());
    assert_eq!(sensor.sample(), Err(DriverError::Bus(ErrorKind::ModeFault)));
}

#[test]
fn an_emulated_sensor_speaks_the_same_protocol() {
    let mut sensor = BioTac::new(BioTacChip::showing(example()), NoopDelay::new());
    sensor.start().unwrap();
    assert_eq!(sensor.sample(), Ok(example()));
    let turned = Frame { tdc: 7, ..example() };
    sensor.spi().show(&turned);
    let polled: Vec<_> = (0..44).map(|_| sensor.poll().unwrap()).collect();
    assert!(polled[..43].iter().all(Option::is_none));
    assert_eq!(polled[43], Some(turned));
    sensor.spi().set_fault(Fault::Noise);
    assert_eq!(sensor.sample(), Err(DriverError::Parity { slot: 0 }));
    sensor.spi().set_fault(Fault::Missing);
    assert_eq!(sensor.start(), Err(DriverError::Missing));
    sensor.spi().set_fault(Fault::None);
    assert_eq!(sensor.sample(), Ok(turned));
}

#[test]
fn pauses_are_given_back() {
    let want = example();
    let bus: Vec<_> = (0..44)
        .flat_map(|slot| sampled(Channel::of_slot(slot).command(), encode(want.slot(slot))))
        .collect();
    let mut spi = Mock::new(&bus);
    let now = core::cell::Cell::new(u32::MAX - 500);
    let mut sensor = Paced::new(spi.clone(), || now.get());
    // Every poll at which the bus is used, by the microsecond; the rest returns at once.
    let (mut frames, mut uses) = (0, Vec::new());
    while frames == 0 {
        let before = (sensor.next, sensor.asked);
        frames += sensor.poll().unwrap().map_or(0, |frame| (frame == want) as u32 + 1);
        if (sensor.next, sensor.asked) != before {
            uses.push(now.get());
        }
        now.set(now.get().wrapping_add(1));
    }
    spi.done();
    assert_eq!((frames, uses.len()), (2, 88));
    for (k, pair) in uses.windows(2).enumerate() {
        // Fifty microseconds after a command, ten after an answer, and what a tick may hide.
        let pause = if k % 2 == 0 { 51 } else { 11 };
        assert_eq!(pair[1].wrapping_sub(pair[0]), pause, "{k}");
    }
}

#[test]
fn a_paced_sensor_names_what_is_wrong() {
    let [high, low] = encode(2893);
    let good = sampled([0xa2, 0x01], [high, low]);
    let bad = sampled([0x80, 0x01], [high, low ^ 0x40]);
    let mut spi = Mock::new(&[good.clone(), bad, good].concat());
    let now = core::cell::Cell::new(0);
    let tick = || {
        now.set(now.get() + 30);
        now.get()
    };
    let mut sensor = Paced::new(spi.clone(), tick);
    assert_eq!(sensor.sample(), Err(DriverError::Parity { slot: 1 }));
    // A new frame begins with its first slot.
    while sensor.next == 0 {
        assert_eq!(sensor.poll(), Ok(None));
    }
    spi.done();
    for silence in [[0, 0], [0xff, 0xff]] {
        let mut spi = Mock::new(&sampled([0x86, 0x01], silence));
        assert_eq!(Paced::new(spi.clone(), tick).start(), Err(DriverError::Missing));
        spi.done();
    }
    let mut broken = Paced::new(crate::driver::tests::Broken, || 7);
    assert_eq!(broken.poll(), Err(DriverError::Bus(ErrorKind::ModeFault)));
    assert_eq!(broken.poll(), Ok(None), "not at once again");
    // A clock that stands still.
    let mut stuck = Paced::new(BioTacChip::showing(example()), || 7);
    assert_eq!(stuck.start(), Err(DriverError::Timeout));
}

proptest! {
    #[test]
    fn twelve_bits_survive(value in 0u16..4096) {
        prop_assert_eq!(decode(encode(value)), Some(value));
    }

    #[test]
    fn one_wrong_bit_is_seen(value in 0u16..4096, bit in 0usize..16) {
        let mut bytes = encode(value);
        bytes[bit / 8] ^= 1 << (bit % 8);
        prop_assert_eq!(decode(bytes), None);
    }

    #[test]
    fn any_words_give_a_frame_or_an_error(words in proptest::collection::vec(any::<[u8; 2]>(), 44)) {
        let mut spi = crate::driver::tests::Echo::new(words.iter().map(|w| w.to_vec()).collect());
        let mut sensor = BioTac::new(&mut spi, NoopDelay::new());
        match sensor.sample() {
            Ok(frame) => for (slot, &word) in words.iter().enumerate() {
                prop_assert_eq!(Some(frame.slot(slot)), decode(word));
            },
            Err(DriverError::Parity { slot }) => {
                prop_assert_eq!(decode(words[usize::from(slot)]), None);
            }
            Err(other) => prop_assert_eq!(other, DriverError::Missing),
        }
    }
}
