//! The subset of Python's pickle language in files of weights: a stack machine that builds numbers, strings, lists,
//! dictionaries and descriptions of tensors. No code of the pickle is executed, and all other instructions are refused.
//!
//! Reference: the comments of `pickletools.py` in Python's standard library, protocols 2 to 4.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

/// A value of a pickle. Lists and dictionaries are shared, because the pickle fills them after storing them in its memo.
#[derive(Clone, Debug)]
pub(crate) enum Value {
    /// `None`, and values that are irrelevant for weights.
    Nothing,
    /// A boolean or an integer.
    Int(i64),
    /// A string.
    Text(String),
    /// A global: a module and a name in it.
    Global(String, String),
    /// A tuple.
    Tuple(Rc<[Value]>),
    /// A list.
    List(Rc<RefCell<Vec<Value>>>),
    /// A dictionary, as pairs in the order of the file.
    Table(Rc<RefCell<Vec<(Value, Value)>>>),
    /// A storage: numbers elsewhere in the file.
    Storage(Storage),
    /// A tensor, as a view of a storage.
    Tensor(TensorView),
}

/// f32 values elsewhere in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Storage {
    /// The key of the storage.
    pub(crate) key: String,
    /// Number of values.
    pub(crate) len: usize,
}

/// A row-major part of a storage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct TensorView {
    /// The storage of the values.
    pub(crate) storage: Storage,
    /// Index of the first value.
    pub(crate) offset: usize,
    /// Sizes, outermost first.
    pub(crate) shape: Vec<usize>,
}

/// Reads one pickle at the beginning of `bytes`; returns its value and the remaining bytes.
pub(crate) fn read(bytes: &[u8]) -> Result<(Value, &[u8]), String> {
    let mut machine = Machine { rest: bytes, stack: Vec::new(), marks: Vec::new(), memo: BTreeMap::new() };
    loop {
        if let Some(value) = machine.step()? {
            return Ok((value, machine.rest));
        }
    }
}

struct Machine<'a> {
    rest: &'a [u8],
    stack: Vec<Value>,
    /// Heights of the stack at the open marks.
    marks: Vec<usize>,
    memo: BTreeMap<u32, Value>,
}

impl<'a> Machine<'a> {
    /// Executes one instruction; the last instruction returns the value.
    fn step(&mut self) -> Result<Option<Value>, String> {
        let [opcode] = self.array()?;
        match opcode {
            b'.' => return self.pop().map(Some),
            0x80 => drop(self.take(1)?), // the protocol
            0x95 => drop(self.take(8)?), // the length of a frame
            b'(' => self.marks.push(self.stack.len()),
            b'N' => self.stack.push(Value::Nothing),
            0x88 => self.stack.push(Value::Int(1)),
            0x89 => self.stack.push(Value::Int(0)),
            b'J' | b'K' | b'M' | 0x8a => self.integer(opcode)?,
            b'G' => self.ignored(8)?, // a float, which is never a shape or an offset
            b'T' | b'U' | b'X' | 0x8c => self.text(opcode)?,
            b'c' | 0x93 => self.global(opcode)?,
            b'q' | b'r' | 0x94 => self.put_memo(opcode)?,
            b'h' | b'j' => self.get_memo(opcode)?,
            b')' | b't' | 0x85..=0x87 => self.tuple(opcode)?,
            b']' => self.stack.push(Value::List(Rc::default())),
            b'}' => self.stack.push(Value::Table(Rc::default())),
            b'a' | b'e' => self.append(opcode)?,
            b's' | b'u' => self.set(opcode)?,
            b'Q' => self.persistent()?,
            b'R' => self.call()?,
            // Attributes of an object, e.g. the versions that torch stores with a dictionary; they are not needed.
            b'b' => drop(self.pop()?),
            _ => return Err(format!("pickle instruction {opcode:#04x} is not supported")),
        }
        Ok(None)
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], String> {
        let (taken, rest) = self.rest.split_at_checked(count).ok_or("the pickle ends early")?;
        self.rest = rest;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], String> {
        Ok(self.take(N)?.try_into().expect("as many bytes as were taken"))
    }

    fn pop(&mut self) -> Result<Value, String> {
        let bottom = self.marks.last().copied().unwrap_or(0);
        let value = if self.stack.len() > bottom { self.stack.pop() } else { None };
        value.ok_or_else(|| "the stack of the pickle is empty".into())
    }

    /// Pops the values since the last mark.
    fn pop_to_mark(&mut self) -> Result<Vec<Value>, String> {
        let mark = self.marks.pop().ok_or("the pickle has no open mark")?;
        Ok(self.stack.split_off(mark))
    }

    fn ignored(&mut self, bytes: usize) -> Result<(), String> {
        self.take(bytes)?;
        self.stack.push(Value::Nothing);
        Ok(())
    }

    fn integer(&mut self, opcode: u8) -> Result<(), String> {
        let value = match opcode {
            b'J' => i64::from(i32::from_le_bytes(self.array()?)),
            b'K' => i64::from(u8::from_le_bytes(self.array()?)),
            b'M' => i64::from(u16::from_le_bytes(self.array()?)),
            _ => {
                let [len] = self.array()?;
                let digits = self.take(usize::from(len))?;
                if digits.len() > 8 {
                    return Err("an integer has more than 64 bits".into());
                }
                // Little-endian two's complement: the last byte contains the sign.
                let fill = if digits.last().is_some_and(|last| last & 0x80 != 0) { 0xff } else { 0 };
                let mut bytes = [fill; 8];
                bytes[..digits.len()].copy_from_slice(digits);
                i64::from_le_bytes(bytes)
            }
        };
        self.stack.push(Value::Int(value));
        Ok(())
    }

    fn text(&mut self, opcode: u8) -> Result<(), String> {
        let len = match opcode {
            b'U' | 0x8c => u32::from(u8::from_le_bytes(self.array()?)),
            _ => u32::from_le_bytes(self.array()?),
        };
        let bytes = self.take(len as usize)?;
        let text = std::str::from_utf8(bytes).map_err(|_| "a string is not UTF-8")?;
        self.stack.push(Value::Text(text.into()));
        Ok(())
    }

    fn global(&mut self, opcode: u8) -> Result<(), String> {
        let [module, name] = if opcode == b'c' {
            [self.line()?, self.line()?]
        } else {
            let (name, module) = (self.pop()?, self.pop()?);
            [module, name].map(|value| if let Value::Text(text) = value { text } else { String::new() })
        };
        self.stack.push(Value::Global(module, name));
        Ok(())
    }

    fn line(&mut self) -> Result<String, String> {
        let end = self.rest.iter().position(|byte| *byte == b'\n').ok_or("the pickle ends early")?;
        let line = String::from_utf8_lossy(self.take(end)?).into_owned();
        self.take(1)?;
        Ok(line)
    }

    fn put_memo(&mut self, opcode: u8) -> Result<(), String> {
        let place = match opcode {
            b'q' => u32::from(u8::from_le_bytes(self.array()?)),
            b'r' => u32::from_le_bytes(self.array()?),
            _ => self.memo.len() as u32,
        };
        let value = self.stack.last().ok_or("the pickle stores an empty stack in its memo")?.clone();
        self.memo.insert(place, value);
        Ok(())
    }

    fn get_memo(&mut self, opcode: u8) -> Result<(), String> {
        let place = match opcode {
            b'h' => u32::from(u8::from_le_bytes(self.array()?)),
            _ => u32::from_le_bytes(self.array()?),
        };
        let value = self.memo.get(&place).ok_or("the pickle reads a missing memo entry")?.clone();
        self.stack.push(value);
        Ok(())
    }

    fn tuple(&mut self, opcode: u8) -> Result<(), String> {
        let items = match opcode {
            b')' => Vec::new(),
            b't' => self.pop_to_mark()?,
            _ => {
                let mut items = (0x85..=opcode).map(|_| self.pop()).collect::<Result<Vec<_>, _>>()?;
                items.reverse();
                items
            }
        };
        self.stack.push(Value::Tuple(items.into()));
        Ok(())
    }

    fn append(&mut self, opcode: u8) -> Result<(), String> {
        let items = if opcode == b'a' { vec![self.pop()?] } else { self.pop_to_mark()? };
        match self.stack.last() {
            Some(Value::List(list)) => list.borrow_mut().extend(items),
            _ => return Err("the pickle appends to a value that is not a list".into()),
        }
        Ok(())
    }

    fn set(&mut self, opcode: u8) -> Result<(), String> {
        let items = match opcode {
            b's' => {
                let (value, key) = (self.pop()?, self.pop()?);
                vec![key, value]
            }
            _ => self.pop_to_mark()?,
        };
        let (pairs, odd) = items.as_chunks::<2>();
        match self.stack.last() {
            Some(Value::Table(table)) if odd.is_empty() => {
                table.borrow_mut().extend(pairs.iter().map(|[key, value]| (key.clone(), value.clone())));
                Ok(())
            }
            _ => Err("the pickle sets items of a value that is not a dictionary".into()),
        }
    }

    /// Reads a persistent id `("storage", type, key, location, length, …)`.
    fn persistent(&mut self) -> Result<(), String> {
        let id = self.pop()?;
        let Value::Tuple(parts) = &id else { return Err("a persistent id is not a storage".into()) };
        let [Value::Text(what), Value::Global(_, kind), Value::Text(key), _, Value::Int(len), ..] = &parts[..] else {
            return Err("a persistent id is not a storage".into());
        };
        if what != "storage" || kind != "FloatStorage" {
            return Err(format!("a {what} has the type {kind} instead of 32-bit floats"));
        }
        let len = usize::try_from(*len).map_err(|_| "a storage has a negative length")?;
        self.stack.push(Value::Storage(Storage { key: key.clone(), len }));
        Ok(())
    }

    /// Evaluates the supported calls, which build dictionaries and tensors.
    fn call(&mut self) -> Result<(), String> {
        let (arguments, function) = (self.pop()?, self.pop()?);
        let (Value::Global(module, name), Value::Tuple(arguments)) = (&function, &arguments) else {
            return Err("the pickle calls a value that is not a function".into());
        };
        let value = match (module.as_str(), name.as_str(), &arguments[..]) {
            ("collections", "OrderedDict", []) => Value::Table(Rc::default()),
            ("collections", "OrderedDict", [Value::List(pairs)]) => table(&pairs.borrow())?,
            ("torch._utils", "_rebuild_tensor" | "_rebuild_tensor_v2", [Value::Storage(storage), rest @ ..]) => {
                tensor(storage, rest)?
            }
            ("torch._utils", "_rebuild_parameter", [data @ Value::Tensor(_), ..])
            | ("torch.nn.parameter", "Parameter", [data @ Value::Tensor(_), ..]) => data.clone(),
            _ => return Err(format!("a call of {module}.{name} is not supported")),
        };
        self.stack.push(value);
        Ok(())
    }
}

/// Builds a dictionary from a list of pairs.
fn table(pairs: &[Value]) -> Result<Value, String> {
    let pair = |pair: &Value| match pair {
        Value::List(items) => match items.borrow().as_slice() {
            [key, value] => Ok((key.clone(), value.clone())),
            _ => Err("a dictionary entry is not a pair".to_owned()),
        },
        _ => Err("a dictionary entry is not a pair".to_owned()),
    };
    Ok(Value::Table(Rc::new(RefCell::new(pairs.iter().map(pair).collect::<Result<_, _>>()?))))
}

/// Builds a tensor from its offset, shape and strides; only row-major strides are supported.
fn tensor(storage: &Storage, arguments: &[Value]) -> Result<Value, String> {
    let [Value::Int(offset), Value::Tuple(shape), Value::Tuple(strides), ..] = arguments else {
        return Err("a tensor lacks its offset, shape or strides".into());
    };
    let size = |value: &Value| match value {
        Value::Int(size) => usize::try_from(*size).ok(),
        _ => None,
    };
    let sizes = |values: &[Value]| values.iter().map(size).collect::<Option<Vec<_>>>();
    let (Some(offset), Some(shape), Some(strides)) = (usize::try_from(*offset).ok(), sizes(shape), sizes(strides))
    else {
        return Err("a tensor has a negative size".into());
    };
    let mut row_major = 1_usize;
    for (size, stride) in shape.iter().zip(&strides).rev() {
        if *size > 1 && *stride != row_major {
            return Err(format!("a tensor of shape {shape:?} with strides {strides:?} is not row-major"));
        }
        row_major = row_major.checked_mul(*size).ok_or("a tensor is larger than memory")?;
    }
    if shape.len() != strides.len() || offset.checked_add(row_major).is_none_or(|end| end > storage.len) {
        return Err(format!("a tensor of shape {shape:?} at offset {offset} exceeds its storage of {}", storage.len));
    }
    Ok(Value::Tensor(TensorView { storage: storage.clone(), offset, shape }))
}
