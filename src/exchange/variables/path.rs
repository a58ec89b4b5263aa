//! Paths to variables, as MATLAB writes them.

use super::LOOKED_AT;
use super::value::{Numbers, Value};

/// Every array of numbers with its path, to any depth.
pub(super) fn leaves(root: &[(String, Value)]) -> Vec<(String, &Numbers)> {
    fn walk<'a>(path: String, value: &'a Value, into: &mut Vec<(String, &'a Numbers)>) {
        match value {
            Value::Numbers(numbers) => into.push((path, numbers)),
            Value::Structs { count, fields } => {
                for element in 0..(*count).min(LOOKED_AT) {
                    let at = if *count == 1 { String::new() } else { format!("({})", element + 1) };
                    for (name, values) in fields {
                        if let Some(value) = values.get(element) {
                            walk(format!("{path}{at}.{name}"), value, into);
                        }
                    }
                }
            }
            Value::Cells(items) => {
                for (at, item) in items.iter().enumerate().take(LOOKED_AT) {
                    walk(format!("{path}{{{}}}", at + 1), item, into);
                }
            }
            Value::Text(_) | Value::Other(_) => {}
        }
    }
    let mut leaves = Vec::new();
    for (name, value) in root {
        walk(name.clone(), value, &mut leaves);
    }
    leaves
}

/// The fields of the one struct that a path means.
pub(super) fn fields_at<'a>(root: &'a [(String, Value)], path: &str) -> Option<Vec<(String, &'a Value)>> {
    let (value, rest) = follow(root, path).ok()?;
    let Value::Structs { count, fields } = value else { return None };
    let element = match rest {
        Rest::Nothing if *count == 1 => 0,
        Rest::Element(at) => at,
        _ => return None,
    };
    fields.iter().map(|(name, values)| Some((name.clone(), values.get(element)?))).collect()
}

/// What a path's last part asks of the value that it leads to.
enum Rest {
    Nothing,
    Element(usize),
    Column(usize),
    Row(usize),
}

/// The vector that a path means.
pub(super) fn lookup(root: &[(String, Value)], path: &str) -> Result<Vec<f64>, String> {
    let (value, rest) = follow(root, path)?;
    let Value::Numbers(numbers) = value else { return Err(format!("{path} is no array of numbers")) };
    if numbers.is_complex {
        return Err(format!("{path} is complex, and a signal is real"));
    }
    let Numbers { rows, columns, values, .. } = numbers;
    match rest {
        Rest::Nothing if *rows == 1 || *columns == 1 => Ok(values.clone()),
        Rest::Nothing => Err(format!("{path} has {rows} rows and {columns} columns; take one, such as {path}(:,1)")),
        Rest::Column(at) | Rest::Element(at) if at >= *columns => Err(format!("{path}: there are {columns} columns")),
        Rest::Column(at) => numbers.column(at).map(<[f64]>::to_vec).ok_or_else(|| format!("{path} is not there")),
        Rest::Row(at) if at >= *rows => Err(format!("{path}: there are {rows} rows")),
        Rest::Row(at) => Ok(values.iter().skip(at).step_by(*rows).copied().collect()),
        Rest::Element(_) => Err(format!("{path} is one number; a column is written (:,1)")),
    }
}

/// Follows a path to a value; an index of a struct, or of a matrix, may be left over.
fn follow<'a>(root: &'a [(String, Value)], path: &str) -> Result<(&'a Value, Rest), String> {
    let end = path.find(['.', '(', '{']).unwrap_or(path.len());
    // A name may hold such characters itself.
    let by_name = |name: &str| root.iter().find(|(n, _)| n == name).map(|(_, value)| value);
    if let Some(value) = by_name(path) {
        return Ok((value, Rest::Nothing));
    }
    let mut value = by_name(&path[..end]).ok_or_else(|| format!("there is no variable {:?}", &path[..end]))?;
    let mut rest = Rest::Nothing;
    let mut left = &path[end..];
    while let Some(first) = left.chars().next() {
        if matches!(rest, Rest::Column(_) | Rest::Row(_)) {
            return Err(format!("{left:?} follows where {path:?} ends"));
        }
        if first == '.' {
            let name_end = left[1..].find(['.', '(', '{']).map_or(left.len(), |at| at + 1);
            let name = &left[1..name_end];
            let Value::Structs { count, fields } = value else {
                return Err(format!("{:?} is no struct with a field {name:?}", &path[..path.len() - left.len()]));
            };
            let element = match rest {
                Rest::Element(at) => at,
                _ if *count == 1 => 0,
                _ => {
                    let own = &path[..path.len() - left.len()];
                    return Err(format!("{own:?} has {count} elements; say which, such as {own}(1){left}"));
                }
            };
            value = fields.iter().find(|(n, _)| n == name).and_then(|(_, values)| values.get(element)).ok_or_else(
                || {
                    let own: Vec<&str> = fields.iter().map(|(n, _)| n.as_str()).collect();
                    format!("there is no field {name:?} (element {}); there are {}", element + 1, own.join(", "))
                },
            )?;
            rest = Rest::Nothing;
            left = &left[name_end..];
            continue;
        }
        let close = if first == '{' { '}' } else { ')' };
        let end = left.find(close).ok_or_else(|| format!("{path:?} has no {close:?}"))?;
        let inside: String = left[1..end].chars().filter(|c| !c.is_whitespace()).collect();
        let number = |text: &str| {
            text.parse::<usize>()
                .ok()
                .and_then(|n| n.checked_sub(1))
                .ok_or_else(|| format!("{text:?} is no index from 1"))
        };
        rest = if first == '{' {
            let Value::Cells(items) = value else { return Err(format!("{path:?} leads to no cells")) };
            value = items.get(number(&inside)?).ok_or_else(|| format!("there are {} cells", items.len()))?;
            Rest::Nothing
        } else if let Some(column) = inside.strip_prefix(":,") {
            Rest::Column(number(column)?)
        } else if let Some(row) = inside.strip_suffix(",:") {
            Rest::Row(number(row)?)
        } else {
            Rest::Element(number(&inside)?)
        };
        left = &left[end + 1..];
    }
    Ok((value, rest))
}
