//! Common Data Representation, little-endian, as ROS 2 puts messages on the wire (OMG DDSI-RTPS 2.5,
//! section 10; "XCDR1", `PLAIN_CDR`): every number starts at a multiple of its own size, counted from
//! behind the four bytes that name the encoding.

/// The encoding's name: little-endian, no options.
const ENCAPSULATION: [u8; 4] = [0, 1, 0, 0];

/// A message that is being written.
pub(super) struct Cdr(Vec<u8>);

impl Cdr {
    /// An empty message.
    pub fn new() -> Self {
        let mut bytes = Vec::with_capacity(512);
        bytes.extend(ENCAPSULATION);
        Cdr(bytes)
    }

    /// The finished message, encapsulation first.
    pub fn into_bytes(self) -> Vec<u8> {
        self.0
    }

    /// A number of `N` bytes, little end first.
    fn number<const N: usize>(&mut self, bytes: [u8; N]) {
        let behind = (self.0.len() - ENCAPSULATION.len()) % N;
        if behind > 0 {
            self.0.resize(self.0.len() + N - behind, 0);
        }
        self.0.extend_from_slice(&bytes);
    }

    pub fn u8(&mut self, value: u8) {
        self.0.push(value);
    }

    pub fn bool(&mut self, value: bool) {
        self.u8(value.into());
    }

    pub fn i32(&mut self, value: i32) {
        self.number(value.to_le_bytes());
    }

    pub fn u32(&mut self, value: u32) {
        self.number(value.to_le_bytes());
    }

    pub fn f32(&mut self, value: f32) {
        self.number(value.to_le_bytes());
    }

    pub fn f64(&mut self, value: f64) {
        self.number(value.to_le_bytes());
    }

    pub fn f64s(&mut self, values: impl IntoIterator<Item = f64>) {
        values.into_iter().for_each(|v| self.f64(v));
    }

    /// Text: its length with the zero byte that ends it, then both.
    pub fn string(&mut self, text: &str) {
        let length = shown(text.len() + 1) - 1;
        self.u32(length as u32 + 1);
        self.0.extend_from_slice(&text.as_bytes()[..length]);
        self.0.push(0);
    }

    /// A sequence of bytes.
    pub fn bytes(&mut self, bytes: &[u8]) {
        let length = shown(bytes.len());
        self.u32(length as u32);
        self.0.extend_from_slice(&bytes[..length]);
    }

    /// A sequence: how many, then each by `put`.
    pub fn sequence<T>(&mut self, items: &[T], mut put: impl FnMut(&mut Self, &T)) {
        let length = shown(items.len());
        self.u32(length as u32);
        items[..length].iter().for_each(|item| put(self, item));
    }
}

/// A length as far as a message can say it.
fn shown(length: usize) -> usize {
    length.min(u32::MAX as usize)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_stand_at_multiples_of_their_size() {
        let mut cdr = Cdr::new();
        cdr.u8(7);
        cdr.u32(0x0102_0304);
        cdr.bool(true);
        cdr.f64(1.0);
        let expected = [
            &[0, 1, 0, 0][..],
            &[7, 0, 0, 0, 4, 3, 2, 1],
            &[1, 0, 0, 0, 0, 0, 0, 0],
            &[0, 0, 0, 0, 0, 0, 0xf0, 0x3f],
        ];
        assert_eq!(cdr.into_bytes(), expected.concat());
    }

    #[test]
    fn texts_end_with_zero_and_sequences_begin_with_their_length() {
        let mut cdr = Cdr::new();
        cdr.string("ab");
        cdr.string("");
        cdr.bytes(&[9]);
        cdr.sequence(&[1.0f32, 2.0], |cdr, v| cdr.f32(*v));
        let expected = [
            &[0, 1, 0, 0][..],
            &[3, 0, 0, 0, b'a', b'b', 0, 0],
            &[1, 0, 0, 0, 0, 0, 0, 0],
            &[1, 0, 0, 0, 9, 0, 0, 0],
            &[2, 0, 0, 0, 0, 0, 0x80, 0x3f, 0, 0, 0, 0x40],
        ];
        assert_eq!(cdr.into_bytes(), expected.concat());
    }
}
