//! Writing grasp logs, and writing files fully or not at all.

use std::borrow::Cow;
use std::io::{BufWriter, Error, ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde_json::{Map, Value, json};

use super::{FORMAT, GraspLog, LogError, LoggedContact, LoggedGrasp, Noise, TrueShape, VERSION};
use crate::space::{self, Point, Pose};

/// Fills a temporary neighbour of `path` and renames it to `path` once it is complete, so that
/// whoever looks at `path`, after a crash too, sees the old file, the new one, or none, never a
/// part. Something that is not a regular file, such as `/dev/stdout`, is written to directly.
///
/// # Errors
/// When the folder does not exist or cannot be written, when `path` is a folder, or when `fill`
/// fails; nothing is left behind.
pub fn write_atomically(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> std::io::Result<()>,
) -> std::io::Result<()> {
    // Through a symbolic link the file it names is replaced, not the link.
    let target: PathBuf = std::fs::canonicalize(path).unwrap_or_else(|_| path.into());
    let old = std::fs::metadata(&target);
    if let Ok(metadata) = &old {
        if metadata.is_dir() {
            return Err(Error::new(ErrorKind::IsADirectory, "it is a folder"));
        }
        if !metadata.is_file() {
            let mut writer = BufWriter::new(std::fs::File::options().write(true).open(&target)?);
            fill(&mut writer)?;
            return writer.flush();
        }
    }
    let folder = match target.parent() {
        Some(parent) if parent != Path::new("") => parent,
        _ => Path::new("."),
    };
    match std::fs::metadata(folder) {
        Err(e) if e.kind() == ErrorKind::NotFound => {
            let message = format!("the folder {} does not exist", folder.display());
            return Err(Error::new(ErrorKind::NotFound, message));
        }
        Ok(metadata) if !metadata.is_dir() => {
            let message = format!("{} is not a folder", folder.display());
            return Err(Error::new(ErrorKind::NotADirectory, message));
        }
        _ => {}
    }
    let mut builder = tempfile::Builder::new();
    builder.prefix(".tactile-");
    // Temporary files are private by default; this one becomes an ordinary file.
    #[cfg(unix)]
    builder.permissions(std::os::unix::fs::PermissionsExt::from_mode(0o666));
    let mut file = builder.tempfile_in(folder)?;
    let mut writer = BufWriter::new(file.as_file_mut());
    fill(&mut writer)?;
    writer.flush()?;
    drop(writer);
    // Else the name may be on the disk before the content is.
    file.as_file().sync_all()?;
    // Whoever may read the old file may read the new one, and nobody else.
    if let Ok(metadata) = old {
        file.as_file().set_permissions(metadata.permissions())?;
    }
    file.persist(&target).map_err(|e| e.error)?;
    Ok(())
}

/// Whether both paths name the same regular file, which is there.
pub fn is_same_file(a: &Path, b: &Path) -> bool {
    let real = |path: &Path| std::fs::canonicalize(path).ok().filter(|p| p.is_file());
    real(a).is_some_and(|a| real(b).is_some_and(|b| a == b))
}

impl GraspLog {
    /// Writes the log to `path`, fully or not at all. A true mesh that the new place would no
    /// longer find is named by its full path.
    ///
    /// # Errors
    /// [`LogError`] naming the file and what is wrong; nothing is left behind.
    pub fn write(&self, path: &Path) -> Result<(), LogError> {
        let mut moved;
        let mut log = self;
        if let Some(TrueShape::Mesh { path: written, file }) = &self.shape
            && let Ok(absolute) = std::path::absolute(file)
            && std::path::absolute(path.parent().unwrap_or(Path::new("")).join(written)).ok()
                != Some(absolute.clone())
            && let Some(name) = absolute.to_str()
        {
            moved = self.clone();
            moved.shape = Some(TrueShape::Mesh { path: name.into(), file: absolute.clone() });
            log = &moved;
        }
        write_atomically(path, |writer| log.to_writer(writer)).map_err(|source| LogError::Io {
            file: path.into(),
            action: "write",
            source,
        })
    }

    /// Writes the log as JSON lines. Reading it back gives the same log: numbers are written with
    /// as many digits as it takes. (One without a grasp is written, though only
    /// [`GraspLog::salvage`] reads it.)
    ///
    /// # Errors
    /// When the writer fails, or (`InvalidData`) when the log holds what a log cannot: a number
    /// that is not finite, a finger without a name, or anything else that [`GraspLog::read`]
    /// refuses; then nothing is written.
    pub fn to_writer(&self, writer: &mut (impl Write + ?Sized)) -> std::io::Result<()> {
        let mut text = Vec::new();
        line(&mut text, &self.header()?)?;
        for grasp in &self.grasps {
            let value = self.grasp(grasp).map_err(|e| {
                Error::new(ErrorKind::InvalidData, format!("grasp {}: {e}", grasp.index))
            })?;
            line(&mut text, &value)?;
        }
        // What makes a log sound is known in one place, the reader.
        GraspLog::lines(&text[..], Path::new("the log"), &mut Err)
            .map_err(|e| Error::new(ErrorKind::InvalidData, e))?;
        writer.write_all(&text)
    }

    fn header(&self) -> Result<Value, Error> {
        let mut fields = Map::new();
        fields.insert("format".into(), json!(FORMAT));
        fields.insert("version".into(), json!(VERSION));
        fields.insert("dimension".into(), json!(self.dimension));
        fields.insert("frame".into(), json!("world"));
        fields.insert("description".into(), json!(self.description));
        fields.insert("fingers".into(), json!(self.fingers));
        let mut noise = Map::new();
        let Noise { point, normal, translation, rotation } = self.noise;
        for (name, deviation) in [
            ("point", point),
            ("normal", normal),
            ("translation", translation),
            ("rotation", rotation),
        ] {
            if let Some(deviation) = deviation {
                noise.insert(name.into(), finite(deviation)?);
            }
        }
        if !noise.is_empty() {
            fields.insert("noise".into(), Value::Object(noise));
        }
        let mut truth = Map::new();
        match &self.shape {
            Some(TrueShape::Polygon(vertices)) => {
                let vertices = vertices
                    .iter()
                    .map(|[x, y]| Ok(json!([finite(*x)?, finite(*y)?])))
                    .collect::<Result<Vec<_>, Error>>()?;
                truth.insert("shape".into(), json!({ "polygon": vertices }));
            }
            Some(TrueShape::Mesh { path, .. }) => {
                truth.insert("shape".into(), json!({ "mesh": path }));
            }
            None => {}
        }
        if !truth.is_empty() {
            fields.insert("truth".into(), Value::Object(truth));
        }
        Ok(with_unknown(fields, &without(&self.unknown, "shape", self.shape.is_none())))
    }

    fn grasp(&self, grasp: &LoggedGrasp) -> Result<Value, Error> {
        let mut fields = Map::new();
        fields.insert("grasp".into(), json!(grasp.index));
        if let Some(time) = grasp.time {
            fields.insert("time".into(), finite(time)?);
        }
        let motion = grasp.motion.map(|m| self.pose(&m)).transpose()?;
        fields.insert("motion".into(), motion.unwrap_or(Value::Null));
        let contacts = grasp.contacts.iter().map(|c| self.contact(c));
        fields.insert("contacts".into(), contacts.collect::<Result<_, _>>()?);
        if !grasp.free.is_empty() {
            let free = grasp.free.iter().map(|free| {
                let mut fields = Map::new();
                self.finger(&mut fields, free.finger)?;
                fields.insert("point".into(), self.vector(&free.point)?);
                Ok(with_unknown(fields, &free.unknown))
            });
            fields.insert("free".into(), free.collect::<Result<_, Error>>()?);
        }
        let mut truth = Map::new();
        if let Some(pose) = &grasp.truth {
            truth.insert("pose".into(), self.pose(pose)?);
        }
        if !truth.is_empty() {
            fields.insert("truth".into(), Value::Object(truth));
        }
        Ok(with_unknown(fields, &without(&grasp.unknown, "pose", grasp.truth.is_none())))
    }

    fn contact(&self, contact: &LoggedContact) -> Result<Value, Error> {
        let mut fields = Map::new();
        self.finger(&mut fields, contact.finger)?;
        fields.insert("point".into(), self.vector(&contact.point)?);
        if let Some(normal) = &contact.normal {
            fields.insert("normal".into(), self.vector(normal)?);
        }
        if let Some(deviation) = contact.normal_noise {
            fields.insert("normal_noise".into(), finite(deviation)?);
        }
        if let Some(force) = contact.force {
            fields.insert("force".into(), finite(force)?);
        }
        Ok(with_unknown(fields, &contact.unknown))
    }

    fn finger(&self, fields: &mut Map<String, Value>, finger: Option<usize>) -> Result<(), Error> {
        if let Some(index) = finger {
            let name = self.fingers.get(index).ok_or_else(|| {
                let message = format!("finger {index} has no name in the header");
                Error::new(ErrorKind::InvalidData, message)
            })?;
            fields.insert("finger".into(), json!(name));
        }
        Ok(())
    }

    fn vector(&self, v: &Point) -> Result<Value, Error> {
        let numbers = v.iter().take(self.dimension).map(|x| finite(*x));
        Ok(Value::Array(numbers.collect::<Result<_, _>>()?))
    }

    fn pose(&self, pose: &Pose) -> Result<Value, Error> {
        let translation = self.vector(&pose.translation.vector)?;
        let rotation = if self.dimension == 2 {
            finite(written_angle(pose))?
        } else {
            let q = pose.rotation.coords;
            Value::Array(q.iter().map(|x| finite(*x)).collect::<Result<_, _>>()?)
        };
        Ok(json!({ "translation": translation, "rotation": rotation }))
    }
}

/// The angle of a planar pose which gives exactly this rotation when read back: extracting it
/// rounds, so its nearest neighbours are tried too. A rotation no angle gives exactly (one that was
/// composed from others) comes back within rounding.
fn written_angle(pose: &Pose) -> f64 {
    let angle = space::angle(pose);
    let [mut below, mut above] = [angle; 2];
    for _ in 0..4 {
        for candidate in [below, above] {
            if space::planar(0.0, 0.0, candidate).rotation == pose.rotation {
                return candidate;
            }
        }
        (below, above) = (below.next_down(), above.next_up());
    }
    angle
}

/// JSON has no infinity and no NaN, and would silently become `null`.
fn finite(x: f64) -> Result<Value, Error> {
    match serde_json::Number::from_f64(x) {
        Some(number) => Ok(Value::Number(number)),
        None => Err(Error::new(ErrorKind::InvalidData, format!("{x} is not a finite number"))),
    }
}

/// What nobody knew of `unknown`, without what was inside a `part` of the truth that is gone.
fn without<'a>(
    unknown: &'a Map<String, Value>,
    part: &str,
    is_gone: bool,
) -> Cow<'a, Map<String, Value>> {
    match unknown.get("truth") {
        Some(Value::Object(truth)) if is_gone && truth.contains_key(part) => {
            let mut unknown = unknown.clone();
            if let Some(Value::Object(truth)) = unknown.get_mut("truth") {
                truth.shift_remove(part);
            }
            Cow::Owned(unknown)
        }
        _ => Cow::Borrowed(unknown),
    }
}

/// Unknown fields follow the known ones and never replace them, those inside known objects likewise.
fn with_unknown(mut fields: Map<String, Value>, unknown: &Map<String, Value>) -> Value {
    merge(&mut fields, unknown);
    Value::Object(fields)
}

fn merge(fields: &mut Map<String, Value>, unknown: &Map<String, Value>) {
    for (name, value) in unknown {
        match (fields.get_mut(name), value) {
            (None, _) => {
                fields.insert(name.clone(), value.clone());
            }
            (Some(Value::Object(known)), Value::Object(rest)) => merge(known, rest),
            _ => {}
        }
    }
}

fn line(text: &mut Vec<u8>, value: &Value) -> std::io::Result<()> {
    serde_json::to_writer(&mut *text, value)?;
    text.push(b'\n');
    Ok(())
}
