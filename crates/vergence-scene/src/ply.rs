//! PLY (ASCII, binary little- and big-endian) to a [`Scene`]: one mesh of polygons, with normals, colours and texture
//! coordinates where the file has them. Counts in the header are believed only as far as the data goes.

use std::path::Path;

use crate::Error;
use crate::import::{Bytes, Import};
use crate::lines::linear_from_srgb;
use crate::model::{Local, Material, Mesh, Node, Primitive, Scene, Shading};
use crate::surface::{self, Smoothing};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Encoding {
    Ascii,
    Little,
    Big,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// What stands for 1 in a colour.
    fn full(self) -> f64 {
        match self {
            Self::I8 | Self::U8 => 255.0,
            Self::I16 | Self::U16 => 65535.0,
            Self::I32 | Self::U32 => f64::from(u32::MAX),
            Self::F32 | Self::F64 => 1.0,
        }
    }
}

struct Property {
    name: String,
    scalar: Scalar,
    /// Type of the count where it is a list.
    count: Option<Scalar>,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

struct Header {
    encoding: Encoding,
    elements: Vec<Element>,
    /// Lines in it, and where the data starts.
    lines: usize,
    end: usize,
}

pub(crate) fn load(import: &mut Import<'_>, path: &Path, bytes: Bytes) -> Result<Scene, Error> {
    let header = header(path, &bytes)?;
    let mut data =
        Data { path, bytes: &bytes, at: header.end, line: header.lines + 1, encoding: header.encoding };
    let mut primitive = Primitive::default();
    let mut has_faces = false;
    for element in &header.elements {
        match element.name.as_str() {
            "vertex" => vertices(import, &mut data, element, &mut primitive)?,
            "face" => {
                has_faces |= element.count > 0;
                faces(import, &mut data, element, &mut primitive)?;
            }
            _ => {
                if element.count > 0 {
                    import.warn(format!("PLY elements {:?} are not drawn", element.name));
                }
                data.skip(element)?;
            }
        }
    }
    if !has_faces && !primitive.positions.is_empty() {
        import.warn("points are not drawn");
    }
    let name = path.file_name().map(|name| name.to_string_lossy().into_owned()).unwrap_or_default();
    let mut scene = Scene { name: name.clone(), ..Scene::default() };
    let grey = if primitive.colors.is_empty() { linear_from_srgb(0.8) } else { 1.0 };
    scene.materials.push(Material {
        shading: Shading::MetallicRoughness { metallic: 0.0, roughness: 0.6, texture: None, ior: 1.5 },
        base_color: [grey, grey, grey, 1.0],
        ..Material::default()
    });
    if primitive.indices.is_empty() {
        return Ok(scene);
    }
    if primitive.normals.is_empty() {
        import.charge(path, "normals", primitive.indices.len(), 60)?;
        let point: Vec<u32> = (0..primitive.positions.len() as u32).collect();
        surface::creased_normals(&mut primitive, &point, |_| Smoothing::ByAngle);
    } else {
        surface::unit_normals(&mut primitive);
    }
    scene.meshes.push(Mesh { name: name.clone(), primitives: vec![primitive] });
    scene.nodes.push(Node {
        name,
        parent: None,
        parent_from_node: Local::Trs(vergence_geom::Trs::identity()),
        mesh: Some(0),
        skin: None,
        light: None,
        camera: None,
        label: None,
    });
    Ok(scene)
}

fn header(path: &Path, bytes: &[u8]) -> Result<Header, Error> {
    let invalid = |line: usize, message: String| Error::invalid(path, format!("{line}:1"), message);
    let (mut at, mut lines) = (0, 0);
    let mut encoding = None;
    let mut elements: Vec<Element> = Vec::new();
    loop {
        let rest = &bytes[at..];
        let Some(length) = rest.iter().take(4096).position(|&b| b == b'\n') else {
            let message = if rest.len() > 4096 { "a longer line" } else { "the end of the file" };
            return Err(invalid(lines + 1, format!("expected a line of a PLY header, found {message}")));
        };
        at += length + 1;
        lines += 1;
        let text = String::from_utf8_lossy(&rest[..length]);
        let words: Vec<&str> = text.split_ascii_whitespace().collect();
        let scalar = |name: &str| {
            Scalar::parse(name).ok_or_else(|| {
                invalid(lines, format!("expected a type such as \"float\" or \"uchar\", found {name:?}"))
            })
        };
        match words.as_slice() {
            ["ply"] if lines == 1 => {}
            _ if lines == 1 => {
                return Err(invalid(1, format!("expected \"ply\", found {:?}", text.trim_end())));
            }
            ["format", name, version] => {
                encoding = Some(match (*name, *version) {
                    ("ascii", "1.0") => Encoding::Ascii,
                    ("binary_little_endian", "1.0") => Encoding::Little,
                    ("binary_big_endian", "1.0") => Encoding::Big,
                    _ => {
                        return Err(invalid(
                            lines,
                            format!(
                                "expected ascii, binary_little_endian or binary_big_endian 1.0, found \"{name} {version}\""
                            ),
                        ));
                    }
                });
            }
            ["comment" | "obj_info", ..] | [] => {}
            ["element", name, count] => {
                let count = count
                    .parse()
                    .map_err(|_| invalid(lines, format!("expected a count of elements, found {count:?}")))?;
                elements.push(Element { name: (*name).to_owned(), count, properties: Vec::new() });
            }
            ["property", ..] if elements.is_empty() => {
                return Err(invalid(lines, "expected an element before its properties, found none".into()));
            }
            ["property", "list", count, kind, name] => {
                let property =
                    Property { name: (*name).to_owned(), scalar: scalar(kind)?, count: Some(scalar(count)?) };
                if let Some(element) = elements.last_mut() {
                    element.properties.push(property);
                }
            }
            ["property", kind, name] => {
                let property = Property { name: (*name).to_owned(), scalar: scalar(kind)?, count: None };
                if let Some(element) = elements.last_mut() {
                    element.properties.push(property);
                }
            }
            ["end_header"] => break,
            _ => {
                return Err(invalid(lines, format!("expected a PLY header, found {:?}", text.trim_end())));
            }
        }
    }
    let encoding = encoding.ok_or_else(|| invalid(lines, "expected a format, found none".into()))?;
    Ok(Header { encoding, elements, lines, end: at })
}

/// The values behind the header, and how far they have been read.
struct Data<'a> {
    path: &'a Path,
    bytes: &'a [u8],
    at: usize,
    /// In ASCII files.
    line: usize,
    encoding: Encoding,
}

impl Data<'_> {
    fn place(&self) -> String {
        match self.encoding {
            Encoding::Ascii => format!("{}:1", self.line),
            _ => format!("byte {}", self.at),
        }
    }

    fn invalid(&self, message: impl std::fmt::Display) -> Error {
        Error::invalid(self.path, self.place(), message)
    }

    fn value(&mut self, scalar: Scalar) -> Result<f64, Error> {
        if self.encoding == Encoding::Ascii {
            return self.ascii();
        }
        let size = scalar.size();
        let Some(bytes) = self.bytes.get(self.at..self.at + size) else {
            return Err(self.invalid(format!("expected {size} bytes more, found the end of the file")));
        };
        let mut little = [0; 8];
        little[..size].copy_from_slice(bytes);
        if self.encoding == Encoding::Big {
            little[..size].reverse();
        }
        self.at += size;
        let [a, b, c, d, ..] = little;
        Ok(match scalar {
            Scalar::I8 => f64::from(a as i8),
            Scalar::U8 => f64::from(a),
            Scalar::I16 => f64::from(i16::from_le_bytes([a, b])),
            Scalar::U16 => f64::from(u16::from_le_bytes([a, b])),
            Scalar::I32 => f64::from(i32::from_le_bytes([a, b, c, d])),
            Scalar::U32 => f64::from(u32::from_le_bytes([a, b, c, d])),
            Scalar::F32 => f64::from(f32::from_le_bytes([a, b, c, d])),
            Scalar::F64 => f64::from_le_bytes(little),
        })
    }

    fn ascii(&mut self) -> Result<f64, Error> {
        while let Some(&byte) = self.bytes.get(self.at).filter(|b| b.is_ascii_whitespace()) {
            self.line += usize::from(byte == b'\n');
            self.at += 1;
        }
        let rest = &self.bytes[self.at..];
        let end = rest.iter().position(u8::is_ascii_whitespace).unwrap_or(rest.len());
        let word = &rest[..end];
        if word.is_empty() {
            return Err(self.invalid("expected a number, found the end of the file"));
        }
        let number = std::str::from_utf8(word).ok().and_then(|word| word.parse::<f64>().ok());
        let number = number.ok_or_else(|| {
            let shown = String::from_utf8_lossy(&word[..word.len().min(40)]);
            self.invalid(format!("expected a number, found {shown:?}"))
        })?;
        self.at += end;
        Ok(number)
    }

    /// Reads one property; of a list, each value goes to `each`.
    fn property(&mut self, property: &Property, mut each: impl FnMut(f64)) -> Result<(), Error> {
        let Some(count) = property.count else {
            each(self.value(property.scalar)?);
            return Ok(());
        };
        let count = self.value(count)?;
        if !(0.0..=f64::from(u32::MAX)).contains(&count) || count.fract() != 0.0 {
            return Err(self.invalid(format!("expected a count of values, found {count}")));
        }
        for _ in 0..count as u64 {
            each(self.value(property.scalar)?);
        }
        Ok(())
    }

    fn skip(&mut self, element: &Element) -> Result<(), Error> {
        // Elements without properties take no bytes, however many there are.
        if element.properties.is_empty() {
            return Ok(());
        }
        for _ in 0..element.count {
            for property in &element.properties {
                self.property(property, |_| {})?;
            }
        }
        Ok(())
    }

    /// How many of `count` elements the rest of the file can hold.
    fn believable(&self, element: &Element) -> usize {
        let smallest = match self.encoding {
            Encoding::Ascii => 2 * element.properties.len(),
            _ => element.properties.iter().map(|p| p.count.unwrap_or(p.scalar).size()).sum(),
        };
        let rest = (self.bytes.len() + 1).saturating_sub(self.at);
        usize::try_from(element.count).unwrap_or(usize::MAX).min(rest / smallest.max(1))
    }
}

/// What a property of a vertex is for: which table, which column.
#[derive(Clone, Copy)]
enum Role {
    Position(usize),
    Normal(usize),
    Color(usize),
    Uv(usize),
    Unused,
}

fn role(name: &str) -> Role {
    match name {
        "x" | "y" | "z" => Role::Position((name.as_bytes()[0] - b'x') as usize),
        "nx" => Role::Normal(0),
        "ny" => Role::Normal(1),
        "nz" => Role::Normal(2),
        "red" | "r" | "diffuse_red" => Role::Color(0),
        "green" | "g" | "diffuse_green" => Role::Color(1),
        "blue" | "b" | "diffuse_blue" => Role::Color(2),
        "alpha" | "a" => Role::Color(3),
        "s" | "u" | "texture_u" => Role::Uv(0),
        "t" | "v" | "texture_v" => Role::Uv(1),
        _ => Role::Unused,
    }
}

fn vertices(
    import: &mut Import<'_>,
    data: &mut Data<'_>,
    element: &Element,
    primitive: &mut Primitive,
) -> Result<(), Error> {
    let roles: Vec<Role> = element
        .properties
        .iter()
        .map(|p| if p.count.is_some() { Role::Unused } else { role(&p.name) })
        .collect();
    let columns = |wanted: fn(&Role) -> bool| roles.iter().filter(|role| wanted(role)).count();
    let has_normals = columns(|r| matches!(r, Role::Normal(_))) == 3;
    let has_colors = columns(|r| matches!(r, Role::Color(0..=2))) == 3;
    let has_uv = columns(|r| matches!(r, Role::Uv(_))) == 2;
    if columns(|r| matches!(r, Role::Position(_))) != 3 {
        return Err(
            data.invalid("expected the properties x, y and z of a vertex, found fewer (or some twice)")
        );
    }
    if element.count >= u64::from(u32::MAX) {
        return Err(data.invalid(format!("expected fewer than 2^32 vertices, found {}", element.count)));
    }
    let count = data.believable(element);
    let size = 12 + 12 * usize::from(has_normals) + 16 * usize::from(has_colors) + 8 * usize::from(has_uv);
    import.charge(data.path, "element vertex", count, size)?;
    primitive.positions.reserve_exact(count);
    primitive.normals.reserve_exact(if has_normals { count } else { 0 });
    primitive.colors.reserve_exact(if has_colors { count } else { 0 });
    primitive.uv0.reserve_exact(if has_uv { count } else { 0 });
    for _ in 0..element.count {
        let (mut position, mut normal, mut color, mut uv) =
            ([0.0; 3], [0.0; 3], [0.0, 0.0, 0.0, 1.0], [0.0; 2]);
        for (property, role) in element.properties.iter().zip(&roles) {
            let full = property.scalar.full();
            data.property(property, |value| match *role {
                Role::Position(i) => position[i] = value as f32,
                Role::Normal(i) => normal[i] = value as f32,
                Role::Color(i) => color[i] = (value / full) as f32,
                Role::Uv(i) => uv[i] = value as f32,
                Role::Unused => {}
            })?;
        }
        if !position.iter().chain(&normal).chain(&color).chain(&uv).all(|v| v.is_finite()) {
            return Err(data.invalid("expected finite numbers before here, found others"));
        }
        primitive.positions.push(position);
        if has_normals {
            primitive.normals.push(normal);
        }
        if has_colors {
            let [r, g, b, a] = color;
            primitive.colors.push([
                linear_from_srgb(r),
                linear_from_srgb(g),
                linear_from_srgb(b),
                a.clamp(0.0, 1.0),
            ]);
        }
        if has_uv {
            primitive.uv0.push([uv[0], 1.0 - uv[1]]);
        }
    }
    Ok(())
}

fn faces(
    import: &mut Import<'_>,
    data: &mut Data<'_>,
    element: &Element,
    primitive: &mut Primitive,
) -> Result<(), Error> {
    let is_corners =
        |p: &Property| p.count.is_some() && matches!(p.name.as_str(), "vertex_indices" | "vertex_index");
    if !element.properties.iter().any(is_corners) {
        return Err(data.invalid("expected the list vertex_indices of a face, found none"));
    }
    let count = data.believable(element);
    import.charge(data.path, "element face", count, 12)?;
    primitive.indices.reserve_exact(3 * count);
    let vertices = primitive.positions.len();
    let mut corners: Vec<u32> = Vec::new();
    let mut shape: Vec<[f32; 3]> = Vec::new();
    for _ in 0..element.count {
        corners.clear();
        for property in &element.properties {
            let wanted = is_corners(property);
            let mut bad = None;
            data.property(property, |value| {
                if !wanted {
                } else if value >= 0.0 && value < vertices as f64 && value.fract() == 0.0 {
                    corners.push(value as u32);
                } else {
                    bad = bad.or(Some(value));
                }
            })?;
            if let Some(found) = bad {
                return Err(data.invalid(format!(
                    "expected vertex indices below {vertices} before here, found {found}"
                )));
            }
        }
        match corners.len() {
            3 => primitive.indices.extend(&corners),
            4.. => {
                import.charge(data.path, data.place(), corners.len() - 3, 36)?;
                shape.clear();
                shape.extend(corners.iter().map(|&corner| primitive.positions[corner as usize]));
                crate::polygon::triangulate(&shape, |triangle| {
                    primitive.indices.extend(triangle.map(|corner| corners[corner]));
                });
            }
            _ => import.warn("faces with fewer than three corners are not drawn"),
        }
    }
    Ok(())
}
