//! Schemas as data: what a message holds, for the file, for readers, and for FORMAT.md.

use std::collections::BTreeSet;

use crate::wire::Encoder;

/// The shape of a message, as a reader in another language needs it.
#[derive(Debug)]
pub struct Schema {
    /// With its package: `vergence.Button`, `foxglove.PoseInFrame`.
    pub name: &'static str,
    /// What it is, in a sentence.
    pub about: &'static str,
    /// In the order of their numbers.
    pub fields: &'static [Field],
}

/// One field of a message.
#[derive(Debug)]
pub struct Field {
    /// As in a .proto file.
    pub name: &'static str,
    /// As in a .proto file.
    pub number: u32,
    /// Of one value.
    pub kind: Kind,
    /// Any number of values; packed where they are numbers.
    pub repeated: bool,
    /// Unit and meaning.
    pub about: &'static str,
}

/// The type of a field.
#[derive(Clone, Copy, Debug)]
#[expect(missing_docs, reason = "the names are those of protocol buffers")]
pub enum Kind {
    Double,
    Float,
    Int64,
    Int32,
    Uint64,
    Uint32,
    Sfixed64,
    Fixed32,
    Bool,
    String,
    Bytes,
    Message(&'static Schema),
}

impl Field {
    /// One value.
    pub const fn one(name: &'static str, number: u32, kind: Kind, about: &'static str) -> Self {
        Self { name, number, kind, repeated: false, about }
    }

    /// Any number of values.
    pub const fn many(name: &'static str, number: u32, kind: Kind, about: &'static str) -> Self {
        Self { name, number, kind, repeated: true, about }
    }
}

impl Kind {
    /// As in `google/protobuf/descriptor.proto`.
    fn number(self) -> u64 {
        match self {
            Self::Double => 1,
            Self::Float => 2,
            Self::Int64 => 3,
            Self::Uint64 => 4,
            Self::Int32 => 5,
            Self::Fixed32 => 7,
            Self::Bool => 8,
            Self::String => 9,
            Self::Message(_) => 11,
            Self::Bytes => 12,
            Self::Uint32 => 13,
            Self::Sfixed64 => 16,
        }
    }

    /// As in a .proto file.
    pub fn name(self) -> &'static str {
        match self {
            Self::Double => "double",
            Self::Float => "float",
            Self::Int64 => "int64",
            Self::Uint64 => "uint64",
            Self::Int32 => "int32",
            Self::Bool => "bool",
            Self::String => "string",
            Self::Message(schema) => schema.name,
            Self::Bytes => "bytes",
            Self::Uint32 => "uint32",
            Self::Sfixed64 => "sfixed64",
            Self::Fixed32 => "fixed32",
        }
    }
}

impl Schema {
    fn file(&self) -> String {
        match self.name {
            // Every reader knows it under this name.
            "google.protobuf.Timestamp" => "google/protobuf/timestamp.proto".to_owned(),
            name => format!("{}.proto", name.replace('.', "/")),
        }
    }

    /// The schema and all that it uses, as a serialized `FileDescriptorSet`: what an MCAP schema record of the encoding
    /// `protobuf` holds. One file per message, each after those that it uses.
    pub fn descriptor_set(&self) -> Vec<u8> {
        let mut out = Vec::new();
        let mut done = BTreeSet::new();
        self.append(&mut out, &mut done);
        out
    }

    fn uses(&self) -> impl Iterator<Item = &'static Schema> {
        let mut seen = BTreeSet::new();
        self.fields.iter().filter_map(move |field| match field.kind {
            Kind::Message(schema) => seen.insert(schema.name).then_some(schema),
            _ => None,
        })
    }

    fn append(&self, out: &mut Vec<u8>, done: &mut BTreeSet<&'static str>) {
        if !done.insert(self.name) {
            return;
        }
        for used in self.uses() {
            used.append(out, done);
        }
        let (package, name) = self.name.rsplit_once('.').unwrap_or(("", self.name));
        // FileDescriptorSet.file
        Encoder::new(out).message(1, |file| {
            file.text(1, &self.file());
            file.text(2, package);
            for used in self.uses() {
                file.text(3, &used.file());
            }
            // message_type
            file.message(4, |message| {
                message.text(1, name);
                for field in self.fields {
                    message.message(2, |descriptor| {
                        descriptor.text(1, field.name);
                        descriptor.uint(3, u64::from(field.number));
                        // LABEL_OPTIONAL, LABEL_REPEATED
                        descriptor.uint(4, if field.repeated { 3 } else { 1 });
                        descriptor.uint(5, field.kind.number());
                        if let Kind::Message(schema) = field.kind {
                            descriptor.text(6, &format!(".{}", schema.name));
                        }
                    });
                }
            });
            file.text(12, "proto3");
        });
    }

    /// As the text of a .proto file, for people.
    pub fn to_proto(&self) -> String {
        let (package, name) = self.name.rsplit_once('.').unwrap_or(("", self.name));
        let mut text = format!("// {}\npackage {package};\nmessage {name} {{\n", self.about);
        for field in self.fields {
            let label = if field.repeated { "repeated " } else { "" };
            let (kind, name, number) = (field.kind.name(), field.name, field.number);
            text += &format!("  {label}{kind} {name} = {number}; // {}\n", field.about);
        }
        text + "}\n"
    }
}
