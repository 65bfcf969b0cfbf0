//! The part of Python's pickle language that files of weights are written in: a machine with a stack that makes numbers,
//! texts, lists, tables and descriptions of tensors. Nothing is ever executed; whatever else a pickle asks for is refused.
//!
//! Reference: the comments of `pickletools.py` in Python's standard library, protocols 2 to 4.

use std::cell::RefCell;
use std::collections::BTreeMap;
use std::rc::Rc;

/// What a pickle makes. Lists and tables are shared: they are filled after they were remembered.
#[derive(Clone, Debug)]
pub enum Value {
    /// `None`, and whatever a file of weights says that is of no interest here.
    Nothing,
    /// A truth value or an integer.
    Int(i64),
    /// A text.
    Text(String),
    /// A module and a name in it.
    Global(String, String),
    /// An immutable list.
    Tuple(Rc<[Value]>),
    /// A list.
    List(Rc<RefCell<Vec<Value>>>),
    /// Pairs in the order of the file.
    Table(Rc<RefCell<Vec<(Value, Value)>>>),
    /// Numbers that lie elsewhere in the file, under a key.
    Storage(Storage),
    /// A view of a storage.
    Tensor(TensorView),
}

/// f32 values that lie elsewhere in the file.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Storage {
    /// The name of the storage.
    pub key: String,
    /// How many values it has.
    pub len: usize,
}

/// A row-major part of a storage.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TensorView {
    /// Where the values lie.
    pub storage: Storage,
    /// The first of them.
    pub offset: usize,
    /// Sizes, outermost first.
    pub shape: Vec<usize>,
}

/// Reads one pickle from the beginning of `bytes`; returns its value and what follows it.
pub fn read(bytes: &[u8]) -> Result<(Value, &[u8]), String> {
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
    /// Heights of the stack at open marks.
    marks: Vec<usize>,
    memo: BTreeMap<u32, Value>,
}

impl<'a> Machine<'a> {
    /// Executes one instruction; the last one gives the value.
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
            b'G' => self.ignored(8)?, // a float: no shape or offset is one
            b'T' | b'U' | b'X' | 0x8c => self.text(opcode)?,
            b'c' | 0x93 => self.global(opcode)?,
            b'q' | b'r' | 0x94 => self.remember(opcode)?,
            b'h' | b'j' => self.recall(opcode)?,
            b')' | b't' | 0x85..=0x87 => self.tuple(opcode)?,
            b']' => self.stack.push(Value::List(Rc::default())),
            b'}' => self.stack.push(Value::Table(Rc::default())),
            b'a' | b'e' => self.append(opcode)?,
            b's' | b'u' => self.set(opcode)?,
            b'Q' => self.persistent()?,
            b'R' => self.call()?,
            // Attributes of an object, as the versions that torch notes beside a table: of no interest.
            b'b' => drop(self.pop()?),
            _ => return Err(format!("instruction {opcode:#04x}, which no file of weights needs")),
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
        value.ok_or_else(|| "the pickle takes more than it has".into())
    }

    /// What was pushed since the last mark.
    fn pop_to_mark(&mut self) -> Result<Vec<Value>, String> {
        let mark = self.marks.pop().ok_or("the pickle has no mark to go back to")?;
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
                    return Err("an integer of more than 64 bits".into());
                }
                // Little-endian two's complement: the last byte has the sign.
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
        let text = std::str::from_utf8(bytes).map_err(|_| "a text that is not UTF-8")?;
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

    fn remember(&mut self, opcode: u8) -> Result<(), String> {
        let place = match opcode {
            b'q' => u32::from(u8::from_le_bytes(self.array()?)),
            b'r' => u32::from_le_bytes(self.array()?),
            _ => self.memo.len() as u32,
        };
        let value = self.stack.last().ok_or("the pickle has nothing to remember")?.clone();
        self.memo.insert(place, value);
        Ok(())
    }

    fn recall(&mut self, opcode: u8) -> Result<(), String> {
        let place = match opcode {
            b'h' => u32::from(u8::from_le_bytes(self.array()?)),
            _ => u32::from_le_bytes(self.array()?),
        };
        let value = self.memo.get(&place).ok_or("the pickle recalls what it never remembered")?.clone();
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
            _ => return Err("the pickle appends to what is no list".into()),
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
            _ => Err("the pickle sets items of what is no table".into()),
        }
    }

    /// `("storage", type, key, place, length, …)`: numbers elsewhere in the file.
    fn persistent(&mut self) -> Result<(), String> {
        let id = self.pop()?;
        let Value::Tuple(parts) = &id else { return Err("a reference that is no storage".into()) };
        let [Value::Text(what), Value::Global(_, kind), Value::Text(key), _, Value::Int(len), ..] = &parts[..] else {
            return Err("a reference that is no storage".into());
        };
        if what != "storage" || kind != "FloatStorage" {
            return Err(format!("a {what} of type {kind} where 32-bit floats are expected"));
        }
        let len = usize::try_from(*len).map_err(|_| "a storage of negative length")?;
        self.stack.push(Value::Storage(Storage { key: key.clone(), len }));
        Ok(())
    }

    /// The few calls that describe tables and tensors.
    fn call(&mut self) -> Result<(), String> {
        let (arguments, function) = (self.pop()?, self.pop()?);
        let (Value::Global(module, name), Value::Tuple(arguments)) = (&function, &arguments) else {
            return Err("a call of what is no function".into());
        };
        let value = match (module.as_str(), name.as_str(), &arguments[..]) {
            ("collections", "OrderedDict", []) => Value::Table(Rc::default()),
            ("collections", "OrderedDict", [Value::List(pairs)]) => table(&pairs.borrow())?,
            ("torch._utils", "_rebuild_tensor" | "_rebuild_tensor_v2", [Value::Storage(storage), rest @ ..]) => {
                tensor(storage, rest)?
            }
            ("torch._utils", "_rebuild_parameter", [data @ Value::Tensor(_), ..])
            | ("torch.nn.parameter", "Parameter", [data @ Value::Tensor(_), ..]) => data.clone(),
            _ => return Err(format!("a call of {module}.{name}, which no file of weights needs")),
        };
        self.stack.push(value);
        Ok(())
    }
}

/// A table from a list of lists of two.
fn table(pairs: &[Value]) -> Result<Value, String> {
    let pair = |pair: &Value| match pair {
        Value::List(items) => match items.borrow().as_slice() {
            [key, value] => Ok((key.clone(), value.clone())),
            _ => Err("a table of what are no pairs".to_owned()),
        },
        _ => Err("a table of what are no pairs".to_owned()),
    };
    Ok(Value::Table(Rc::new(RefCell::new(pairs.iter().map(pair).collect::<Result<_, _>>()?))))
}

/// From offset, shape and strides, of which only row-major ones are known.
fn tensor(storage: &Storage, arguments: &[Value]) -> Result<Value, String> {
    let [Value::Int(offset), Value::Tuple(shape), Value::Tuple(strides), ..] = arguments else {
        return Err("a tensor without offset, shape and strides".into());
    };
    let size = |value: &Value| match value {
        Value::Int(size) => usize::try_from(*size).ok(),
        _ => None,
    };
    let sizes = |values: &[Value]| values.iter().map(size).collect::<Option<Vec<_>>>();
    let (Some(offset), Some(shape), Some(strides)) = (usize::try_from(*offset).ok(), sizes(shape), sizes(strides))
    else {
        return Err("a tensor with a negative size".into());
    };
    let mut row_major = 1_usize;
    for (size, stride) in shape.iter().zip(&strides).rev() {
        if *size > 1 && *stride != row_major {
            return Err(format!("a tensor of shape {shape:?} with strides {strides:?} is not row-major"));
        }
        row_major = row_major.checked_mul(*size).ok_or("a tensor larger than memory")?;
    }
    if shape.len() != strides.len() || offset.checked_add(row_major).is_none_or(|end| end > storage.len) {
        return Err(format!("a tensor of shape {shape:?} at {offset} in a storage of {}", storage.len));
    }
    Ok(Value::Tensor(TensorView { storage: storage.clone(), offset, shape }))
}
