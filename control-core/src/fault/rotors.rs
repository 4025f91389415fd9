//! A set of rotors, written as a list of their numbers, 1 to 4.

/// Some of the four rotors.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
pub struct Rotors([bool; 4]);

impl Rotors {
    /// Every rotor.
    pub const ALL: Self = Self([true; 4]);

    /// The set that has rotor `i + 1` where `has[i]`.
    pub const fn new(has: [bool; 4]) -> Self {
        Self(has)
    }

    /// Whether rotor `index + 1` is in it.
    pub fn has(self, index: usize) -> bool {
        self.0.get(index).is_some_and(|&has| has)
    }

    /// How many they are.
    pub fn count(self) -> usize {
        self.indices().count()
    }

    /// Whether there is none.
    pub fn is_empty(self) -> bool {
        self.count() == 0
    }

    /// Whether the two have a rotor in common.
    pub fn meets(self, other: Self) -> bool {
        self.indices().any(|i| other.has(i))
    }

    /// Their indices, 0 to 3, ascending.
    pub fn indices(self) -> impl Iterator<Item = usize> {
        self.0.into_iter().enumerate().filter_map(|(i, has)| has.then_some(i))
    }

    /// Their numbers, 1 to 4, ascending.
    pub fn numbers(self) -> impl Iterator<Item = usize> {
        self.indices().map(|i| i + 1)
    }
}

#[cfg(feature = "serde")]
mod form {
    use super::Rotors;
    use core::fmt;
    use serde::de::{Deserialize, Deserializer, Error, SeqAccess, Visitor};
    use serde::ser::{Serialize, Serializer};

    /// One entry of the list.
    struct Number(usize);

    impl<'de> Deserialize<'de> for Number {
        fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
            let number = i64::deserialize(from)?;
            match usize::try_from(number) {
                Ok(number @ 1..=4) => Ok(Self(number)),
                _ => Err(D::Error::custom("must be one of the rotors 1 to 4")),
            }
        }
    }

    struct List;

    impl<'de> Visitor<'de> for List {
        type Value = Rotors;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a list of the rotors 1 to 4")
        }

        fn visit_seq<A: SeqAccess<'de>>(self, mut list: A) -> Result<Rotors, A::Error> {
            let mut rotors = Rotors::default();
            while let Some(Number(number)) = list.next_element()? {
                if core::mem::replace(&mut rotors.0[number - 1], true) {
                    return Err(A::Error::custom(format_args!("rotor {number} must be named once in a fault")));
                }
            }
            Ok(rotors)
        }
    }

    impl<'de> Deserialize<'de> for Rotors {
        fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
            from.deserialize_seq(List)
        }
    }

    impl Serialize for Rotors {
        fn serialize<S: Serializer>(&self, to: S) -> Result<S::Ok, S::Error> {
            to.collect_seq(self.numbers())
        }
    }
}

#[cfg(feature = "schema")]
mod schema {
    use super::Rotors;
    use schemars::{JsonSchema, Schema, SchemaGenerator, json_schema};
    use std::borrow::Cow;

    impl JsonSchema for Rotors {
        fn schema_name() -> Cow<'static, str> {
            "Rotors".into()
        }

        fn json_schema(_: &mut SchemaGenerator) -> Schema {
            json_schema!({
                "description": "Some of the four rotors.",
                "type": "array",
                "items": { "type": "integer", "minimum": 1, "maximum": 4 },
                "minItems": 1,
                "uniqueItems": true,
            })
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_set_knows_its_rotors() {
        let facing = Rotors::new([true, false, true, false]);
        assert_eq!((facing.count(), facing.is_empty()), (2, false));
        assert!(facing.numbers().eq([1, 3]));
        assert!(facing.has(2) && !facing.has(1) && !facing.has(4));
        assert!(facing.meets(Rotors::ALL) && !facing.meets(Rotors::new([false, true, false, true])));
        assert!(Rotors::default().is_empty());
    }
}
