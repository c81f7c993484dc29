//! The format of saved states: the values of the fields one after the other, as serde presents them. Numbers have a fixed
//! size, least significant byte first. Texts, bytes, sequences and maps begin with their length.

use std::fmt::{self, Display};

use serde_core::de::{
    DeserializeOwned, DeserializeSeed, EnumAccess, IntoDeserializer, MapAccess, SeqAccess,
    VariantAccess, Visitor,
};
use serde_core::ser::{
    SerializeMap, SerializeSeq, SerializeStruct, SerializeStructVariant, SerializeTuple,
    SerializeTupleStruct, SerializeTupleVariant,
};
use serde_core::{Deserializer, Serialize, Serializer, de, ser};

/// The bytes are not a saved struct, or a field cannot be saved.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct StateError;

impl Display for StateError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the state is damaged, or a field cannot be saved")
    }
}

impl std::error::Error for StateError {}

impl ser::Error for StateError {
    fn custom<T: Display>(_: T) -> Self {
        Self
    }
}

impl de::Error for StateError {
    fn custom<T: Display>(_: T) -> Self {
        Self
    }
}

type Result<T = ()> = std::result::Result<T, StateError>;

/// Collects the fields of a struct as bytes.
#[derive(Debug, Default)]
pub struct StateWriter(Vec<u8>);

impl StateWriter {
    /// Adds a field.
    ///
    /// # Errors
    /// It cannot be serialized.
    #[inline(never)] // one copy keeps FMUs small
    pub fn put<T: Serialize>(&mut self, field: &T) -> Result {
        field.serialize(self)
    }

    /// The bytes.
    pub fn into_bytes(self) -> Vec<u8> {
        self.0
    }

    fn length(&mut self, length: usize) {
        self.0.extend_from_slice(&(length as u64).to_le_bytes());
    }
}

/// Reads the fields of a struct from bytes.
#[derive(Debug)]
pub struct StateReader<'de>(&'de [u8]);

impl<'de> StateReader<'de> {
    /// Reads from the start of the bytes.
    pub fn new(bytes: &'de [u8]) -> Self {
        Self(bytes)
    }

    /// Reads the next field.
    ///
    /// # Errors
    /// The bytes are not a value of this type.
    #[inline(never)]
    pub fn take<T: DeserializeOwned>(&mut self) -> Result<T> {
        T::deserialize(self)
    }

    /// Whether all bytes were read.
    pub fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N]> {
        let (array, rest) = self.0.split_first_chunk().ok_or(StateError)?;
        self.0 = rest;
        Ok(*array)
    }

    fn length(&mut self) -> Result<usize> {
        u64::from_le_bytes(self.array()?).try_into().map_err(|_| StateError)
    }

    fn bytes(&mut self) -> Result<&'de [u8]> {
        let length = self.length()?;
        let (bytes, rest) = self.0.split_at_checked(length).ok_or(StateError)?;
        self.0 = rest;
        Ok(bytes)
    }

    fn text(&mut self) -> Result<&'de str> {
        str::from_utf8(self.bytes()?).map_err(|_| StateError)
    }
}

macro_rules! numbers {
    (write $($type:ident $serialize:ident,)*) => { $(
        fn $serialize(self, value: $type) -> Result {
            self.0.extend_from_slice(&value.to_le_bytes());
            Ok(())
        }
    )* };
    (read $($type:ident $deserialize:ident $visit:ident,)*) => { $(
        fn $deserialize<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
            visitor.$visit($type::from_le_bytes(self.array()?))
        }
    )* };
}

impl Serializer for &mut StateWriter {
    type Ok = ();
    type Error = StateError;
    type SerializeSeq = Self;
    type SerializeTuple = Self;
    type SerializeTupleStruct = Self;
    type SerializeTupleVariant = Self;
    type SerializeMap = Self;
    type SerializeStruct = Self;
    type SerializeStructVariant = Self;

    numbers! { write
        i8 serialize_i8, i16 serialize_i16, i32 serialize_i32, i64 serialize_i64, i128 serialize_i128,
        u8 serialize_u8, u16 serialize_u16, u32 serialize_u32, u64 serialize_u64, u128 serialize_u128,
        f32 serialize_f32, f64 serialize_f64,
    }

    fn serialize_bool(self, value: bool) -> Result {
        self.serialize_u8(value.into())
    }

    fn serialize_char(self, value: char) -> Result {
        self.serialize_u32(value.into())
    }

    fn serialize_str(self, text: &str) -> Result {
        self.serialize_bytes(text.as_bytes())
    }

    fn serialize_bytes(self, bytes: &[u8]) -> Result {
        self.length(bytes.len());
        self.0.extend_from_slice(bytes);
        Ok(())
    }

    fn serialize_none(self) -> Result {
        self.serialize_bool(false)
    }

    fn serialize_some<T: Serialize + ?Sized>(self, value: &T) -> Result {
        self.serialize_bool(true)?;
        value.serialize(self)
    }

    fn serialize_unit(self) -> Result {
        Ok(())
    }

    fn serialize_unit_struct(self, _: &'static str) -> Result {
        Ok(())
    }

    fn serialize_unit_variant(self, _: &'static str, index: u32, _: &'static str) -> Result {
        self.serialize_u32(index)
    }

    fn serialize_newtype_struct<T: Serialize + ?Sized>(self, _: &'static str, value: &T) -> Result {
        value.serialize(self)
    }

    fn serialize_newtype_variant<T: Serialize + ?Sized>(
        self,
        _: &'static str,
        index: u32,
        _: &'static str,
        value: &T,
    ) -> Result {
        self.serialize_u32(index)?;
        value.serialize(self)
    }

    fn serialize_seq(self, length: Option<usize>) -> Result<Self> {
        self.length(length.ok_or(StateError)?);
        Ok(self)
    }

    fn serialize_tuple(self, _: usize) -> Result<Self> {
        Ok(self)
    }

    fn serialize_tuple_struct(self, _: &'static str, _: usize) -> Result<Self> {
        Ok(self)
    }

    fn serialize_tuple_variant(
        self,
        _: &'static str,
        index: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self> {
        self.serialize_u32(index)?;
        Ok(self)
    }

    fn serialize_map(self, length: Option<usize>) -> Result<Self> {
        self.serialize_seq(length)
    }

    fn serialize_struct(self, _: &'static str, _: usize) -> Result<Self> {
        Ok(self)
    }

    fn serialize_struct_variant(
        self,
        _: &'static str,
        index: u32,
        _: &'static str,
        _: usize,
    ) -> Result<Self> {
        self.serialize_u32(index)?;
        Ok(self)
    }

    fn is_human_readable(&self) -> bool {
        false
    }
}

/// The parts of a value follow each other without anything between them.
macro_rules! parts {
    ($($trait:ident: $($method:ident $(($key:ty))?),*;)*) => { $(
        impl $trait for &mut StateWriter {
            type Ok = ();
            type Error = StateError;

            $(fn $method<T: Serialize + ?Sized>(&mut self, $(_: $key,)? part: &T) -> Result {
                part.serialize(&mut **self)
            })*

            fn end(self) -> Result {
                Ok(())
            }
        }
    )* };
}
parts! {
    SerializeSeq: serialize_element;
    SerializeTuple: serialize_element;
    SerializeTupleStruct: serialize_field;
    SerializeTupleVariant: serialize_field;
    SerializeMap: serialize_key, serialize_value;
    SerializeStruct: serialize_field(&'static str);
    SerializeStructVariant: serialize_field(&'static str);
}

impl<'de> Deserializer<'de> for &mut StateReader<'de> {
    type Error = StateError;

    numbers! { read
        i8 deserialize_i8 visit_i8, i16 deserialize_i16 visit_i16, i32 deserialize_i32 visit_i32,
        i64 deserialize_i64 visit_i64, i128 deserialize_i128 visit_i128,
        u8 deserialize_u8 visit_u8, u16 deserialize_u16 visit_u16, u32 deserialize_u32 visit_u32,
        u64 deserialize_u64 visit_u64, u128 deserialize_u128 visit_u128,
        f32 deserialize_f32 visit_f32, f64 deserialize_f64 visit_f64,
    }

    fn deserialize_any<V: Visitor<'de>>(self, _: V) -> Result<V::Value> {
        Err(StateError)
    }

    fn deserialize_bool<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        match self.array()? {
            [0] => visitor.visit_bool(false),
            [1] => visitor.visit_bool(true),
            _ => Err(StateError),
        }
    }

    fn deserialize_char<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        let number = u32::from_le_bytes(self.array()?);
        visitor.visit_char(char::from_u32(number).ok_or(StateError)?)
    }

    fn deserialize_str<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        visitor.visit_borrowed_str(self.text()?)
    }

    fn deserialize_bytes<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        visitor.visit_borrowed_bytes(self.bytes()?)
    }

    fn deserialize_option<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        match self.array()? {
            [0] => visitor.visit_none(),
            [1] => visitor.visit_some(self),
            _ => Err(StateError),
        }
    }

    fn deserialize_unit<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        visitor.visit_unit()
    }

    fn deserialize_unit_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value> {
        visitor.visit_unit()
    }

    fn deserialize_newtype_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        visitor: V,
    ) -> Result<V::Value> {
        visitor.visit_newtype_struct(self)
    }

    fn deserialize_seq<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        let left = self.length()?;
        visitor.visit_seq(Elements { of: self, left })
    }

    fn deserialize_tuple<V: Visitor<'de>>(self, left: usize, visitor: V) -> Result<V::Value> {
        visitor.visit_seq(Elements { of: self, left })
    }

    fn deserialize_tuple_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        length: usize,
        visitor: V,
    ) -> Result<V::Value> {
        self.deserialize_tuple(length, visitor)
    }

    fn deserialize_map<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        let left = self.length()?;
        visitor.visit_map(Elements { of: self, left })
    }

    fn deserialize_struct<V: Visitor<'de>>(
        self,
        _: &'static str,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value> {
        self.deserialize_tuple(fields.len(), visitor)
    }

    fn deserialize_enum<V: Visitor<'de>>(
        self,
        _: &'static str,
        _: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value> {
        visitor.visit_enum(self)
    }

    fn is_human_readable(&self) -> bool {
        false
    }

    serde_core::forward_to_deserialize_any! { identifier ignored_any }

    fn deserialize_string<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        self.deserialize_str(visitor)
    }

    fn deserialize_byte_buf<V: Visitor<'de>>(self, visitor: V) -> Result<V::Value> {
        self.deserialize_bytes(visitor)
    }
}

/// The elements of a sequence, or the entries of a map, that are left to read.
struct Elements<'a, 'de> {
    of: &'a mut StateReader<'de>,
    left: usize,
}

impl<'de> Elements<'_, 'de> {
    fn next<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>> {
        let Some(left) = self.left.checked_sub(1) else { return Ok(None) };
        self.left = left;
        seed.deserialize(&mut *self.of).map(Some)
    }
}

impl<'de> SeqAccess<'de> for Elements<'_, 'de> {
    type Error = StateError;

    fn next_element_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>> {
        self.next(seed)
    }

    fn size_hint(&self) -> Option<usize> {
        Some(self.left)
    }
}

impl<'de> MapAccess<'de> for Elements<'_, 'de> {
    type Error = StateError;

    fn next_key_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<Option<T::Value>> {
        self.next(seed)
    }

    fn next_value_seed<T: DeserializeSeed<'de>>(&mut self, seed: T) -> Result<T::Value> {
        seed.deserialize(&mut *self.of)
    }
}

impl<'de> EnumAccess<'de> for &mut StateReader<'de> {
    type Error = StateError;
    type Variant = Self;

    fn variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<(T::Value, Self)> {
        let index = u32::from_le_bytes(self.array()?);
        Ok((seed.deserialize(index.into_deserializer())?, self))
    }
}

impl<'de> VariantAccess<'de> for &mut StateReader<'de> {
    type Error = StateError;

    fn unit_variant(self) -> Result {
        Ok(())
    }

    fn newtype_variant_seed<T: DeserializeSeed<'de>>(self, seed: T) -> Result<T::Value> {
        seed.deserialize(self)
    }

    fn tuple_variant<V: Visitor<'de>>(self, length: usize, visitor: V) -> Result<V::Value> {
        self.deserialize_tuple(length, visitor)
    }

    fn struct_variant<V: Visitor<'de>>(
        self,
        fields: &'static [&'static str],
        visitor: V,
    ) -> Result<V::Value> {
        self.deserialize_tuple(fields.len(), visitor)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;
    use std::fmt::Debug;

    use serde::{Deserialize, Serialize};

    use super::*;

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    enum Mode {
        Off,
        Ramp(f64),
        Hold { from: f32, steps: u16 },
        Both(bool, char),
    }

    #[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
    struct Everything {
        whole: (i8, u8, i16, u16, i32, u32, i64, u64, i128, u128),
        real: [f64; 3],
        modes: Vec<Mode>,
        names: BTreeMap<String, Option<Box<Self>>>,
        unit: (),
    }

    fn bytes<T: Serialize>(value: &T) -> Result<Vec<u8>> {
        let mut writer = StateWriter::default();
        writer.put(value)?;
        Ok(writer.into_bytes())
    }

    fn value<T: DeserializeOwned>(bytes: &[u8]) -> Result<T> {
        let mut reader = StateReader::new(bytes);
        let value = reader.take()?;
        if reader.is_empty() { Ok(value) } else { Err(StateError) }
    }

    fn everything() -> Everything {
        use Mode::{Both, Hold, Off, Ramp};
        let inner = Everything {
            whole: (-1, 2, -3, 4, -5, 6, i64::MIN, u64::MAX, i128::MIN, u128::MAX),
            real: [f64::INFINITY, -0.0, 1e-308],
            modes: vec![Off, Ramp(0.1), Hold { from: -1.5, steps: 7 }, Both(true, 'ϑ')],
            names: BTreeMap::new(),
            unit: (),
        };
        let names = [("".into(), None), ("größer".into(), Some(Box::new(inner.clone())))];
        Everything { names: names.into(), ..inner }
    }

    #[test]
    fn what_is_saved_is_loaded() {
        let saved = bytes(&everything()).unwrap();
        assert_eq!(value(&saved), Ok(everything()));
        // Not a number keeps its bits.
        let strange = f64::from_bits(0xfff4_0000_dead_beef);
        let loaded: f64 = value(&bytes(&strange).unwrap()).unwrap();
        assert_eq!(loaded.to_bits(), strange.to_bits());
    }

    #[test]
    fn numbers_have_a_fixed_size_and_lists_begin_with_their_length() {
        let saved = bytes(&(1_u16, Some(-2_i32), vec![true], "é")).unwrap();
        let expected = [1, 0, 1, 0xfe, 0xff, 0xff, 0xff, 1, 0, 0, 0, 0, 0, 0, 0, 1];
        assert_eq!(saved[..16], expected);
        assert_eq!(saved[16..], [2, 0, 0, 0, 0, 0, 0, 0, 0xc3, 0xa9]);
    }

    #[test]
    fn bytes_that_are_cut_off_are_refused() {
        let saved = bytes(&everything()).unwrap();
        for length in 0..saved.len() {
            assert_eq!(value::<Everything>(&saved[..length]), Err(StateError), "{length}");
        }
    }

    #[test]
    fn bytes_that_are_no_value_of_the_type_are_refused() {
        fn refused<T: DeserializeOwned + Debug + PartialEq>(bytes: &[u8]) {
            assert_eq!(value::<T>(bytes), Err(StateError));
        }
        refused::<bool>(&[2]);
        refused::<Option<u8>>(&[2, 0]);
        refused::<char>(&[0, 0xd8, 0, 0]);
        refused::<Mode>(&[4, 0, 0, 0]);
        refused::<String>(&[1, 0, 0, 0, 0, 0, 0, 0, 0xff]);
        refused::<Vec<u8>>(&[0xff; 8]);
        refused::<u8>(&[0, 0]);
    }

    #[test]
    fn a_list_of_unknown_length_is_refused() {
        struct Odd;
        impl Serialize for Odd {
            fn serialize<S: Serializer>(
                &self,
                serializer: S,
            ) -> std::result::Result<S::Ok, S::Error> {
                serializer.collect_seq((0..9).filter(|n| n % 2 == 1))
            }
        }
        assert_eq!(bytes(&Odd), Err(StateError));
    }
}
