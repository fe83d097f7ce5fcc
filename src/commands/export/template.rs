//! Templates of Open Job Description, version 2023-09.

use std::collections::{BTreeMap, BTreeSet};

use engine::Graph;
use serde_json::{Value, json};

use crate::session::Error;

/// Maximum number of listed values of a task parameter that the specification allows.
const MOST_VALUES: usize = 1024;
/// Maximum length of the name of a step.
const LONGEST_NAME: usize = 64;
/// Minimum time limit of a task in seconds.
const SHORTEST_LIMIT: f64 = 600.0;
/// Factor between the forecast of a task and its time limit. Workers may be slower than this machine.
const PATIENCE: f64 = 10.0;
/// Time in seconds between the request to stop a task and its end, in which it keeps finished nodes.
const NOTICE_S: u32 = 30;
/// Unit of the memory that a worker needs, in MiB.
const MEMORY_STEP: u64 = 256;

/// Properties of a job that do not depend on its graph.
pub struct Job<'a> {
    /// Name of the job.
    pub name: &'a str,
    /// File name of the bundle.
    pub bundle: &'a str,
    /// Server of shared results.
    pub remote: Option<&'a str>,
    /// Minimum number of CPUs of a worker.
    pub cpus: u32,
    /// Memory that the largest node needs, in bytes.
    pub memory_bytes: Option<u64>,
    /// Forecast of the time of the whole job on this machine, in seconds.
    pub seconds: Option<f64>,
}

/// The targets that vary along the same axes.
struct Group<'a> {
    /// Name of the step that computes the targets.
    step: String,
    /// Names of the targets without the values of axes.
    names: BTreeSet<&'a str>,
    /// For each axis: the values, in the order of the instances.
    axes: Vec<(&'a str, Vec<&'a str>)>,
    targets: Vec<usize>,
}

/// The template of a job that computes `targets`, and a text with one line per step. Targets that vary along the same
/// axes are one step, with one task per combination of values. Targets that do not vary are a last step, which waits
/// for the other ones if it reads their results.
///
/// # Errors
/// If a step has more values than a template can list, or if the targets are not all combinations of their values.
pub fn template(graph: &Graph, targets: &[usize], job: &Job<'_>) -> Result<(Value, String), Error> {
    let groups = groups(graph, targets);
    let (varying, rest): (Vec<&Group<'_>>, Vec<&Group<'_>>) =
        groups.iter().partition(|group| !group.axes.is_empty());
    let (mut steps, mut summary) = (Vec::new(), String::new());
    let mut add = |name: String, tasks: usize, step: Value| {
        summary.push_str(&format!("step {name} (tasks: {tasks})\n"));
        steps.push(step);
        name
    };
    let shared = shared(graph, &varying);
    let before: Vec<String> = if job.remote.is_some() && !shared.is_empty() {
        // The name of a node has no space, so no other step has this name.
        vec![add("shared results".to_owned(), 1, step("shared results", &shared.join(","), &[], &[], job))]
    } else {
        Vec::new()
    };
    let mut done = before.clone();
    for group in &varying {
        let parameters = group.axes.iter().map(|axis| parameter(axis)).collect::<Result<Vec<_>, _>>()?;
        let tasks: usize = group.axes.iter().map(|(_, values)| values.len()).product();
        if tasks * group.names.len() != group.targets.len() {
            let names: Vec<&str> = group.names.iter().copied().collect();
            let why = "the job needs every combination of the values of their axes; select all of them, or one axis value";
            return Err(Error::usage(format!("`{}`: {why}", names.join(","))));
        }
        let at: String =
            group.axes.iter().map(|(axis, _)| format!("/{axis}={{{{Task.Param.{axis}}}}}")).collect();
        let only: Vec<String> = group.names.iter().map(|name| format!("{name}{at}")).collect();
        let made = step(&group.step, &only.join(","), &parameters, &before, job);
        done.push(add(group.step.clone(), tasks, made));
    }
    for group in &rest {
        let above = graph.above(&group.targets);
        let waits = (0..above.len()).any(|node| above[node] && !graph.nodes[node].point.is_empty());
        let only: Vec<&str> = group.names.iter().copied().collect();
        let made = step(&group.step, &only.join(","), &[], if waits { &done } else { &before }, job);
        add(group.step.clone(), 1, made);
    }
    let mut parameters = vec![
        json!({"name": "Program", "type": "STRING", "default": "lightharmony",
               "description": "The program, as the workers find it."}),
        json!({"name": "Scene", "type": "PATH", "objectType": "FILE", "dataFlow": "IN", "default": job.bundle,
               "description": "The graph and its input files."}),
        json!({"name": "Output", "type": "PATH", "objectType": "DIRECTORY", "dataFlow": "OUT", "default": "out",
               "description": "The folder of the written files."}),
    ];
    if let Some(remote) = job.remote {
        parameters.push(json!({"name": "Server", "type": "STRING", "default": remote,
                               "description": "Server of shared results; `none` for no server."}));
    }
    let template = json!({
        "specificationVersion": "jobtemplate-2023-09", "name": job.name,
        "parameterDefinitions": parameters, "steps": steps,
    });
    Ok((template, summary))
}

/// The targets by the axes along which they vary.
fn groups<'a>(graph: &'a Graph, targets: &[usize]) -> Vec<Group<'a>> {
    let mut groups = BTreeMap::<Vec<&str>, Group<'a>>::new();
    for &target in targets {
        let node = &graph.nodes[target];
        let axes: Vec<&str> = node.point.iter().map(|(axis, _)| axis.as_str()).collect();
        let group = groups.entry(axes.clone()).or_insert_with(|| Group {
            step: String::new(),
            names: BTreeSet::new(),
            axes: axes.into_iter().map(|axis| (axis, Vec::new())).collect(),
            targets: Vec::new(),
        });
        group.names.insert(node.id.split_once('/').map_or(node.id.as_str(), |(name, _)| name));
        group.targets.push(target);
        for ((_, values), (_, value)) in group.axes.iter_mut().zip(&node.point) {
            let value = value.trim_matches('"');
            if !values.contains(&value) {
                values.push(value);
            }
        }
    }
    let named = |(index, group): (usize, Group<'a>)| Group { step: step_name(&group.names, index), ..group };
    groups.into_values().enumerate().map(named).collect()
}

/// Names of the nodes that do not vary, are read by nodes that do, and take time.
fn shared<'a>(graph: &'a Graph, varying: &[&Group<'_>]) -> Vec<&'a str> {
    let targets: Vec<usize> = varying.iter().flat_map(|group| group.targets.iter().copied()).collect();
    let above = graph.above(&targets);
    let reads_once = |&node: &usize| {
        let is_shared = above[node] && graph.nodes[node].point.is_empty() && !graph.nodes[node].kind.instant;
        is_shared
            && graph.consumers(node).iter().any(|&next| above[next] && !graph.nodes[next].point.is_empty())
    };
    (0..above.len()).filter(reads_once).map(|node| graph.nodes[node].id.as_str()).collect()
}

/// A name that no other step has, since a node is in one group only. The step has a number instead if the name of the
/// node is too long.
fn step_name(names: &BTreeSet<&str>, index: usize) -> String {
    let first = names.first().copied().unwrap_or_default();
    let name = match names.len() {
        0 | 1 => first.to_owned(),
        count => format!("{first} and {} more", count - 1),
    };
    if name.len() > LONGEST_NAME { format!("step {}", index + 1) } else { name }
}

/// A step that runs the graph for the nodes `only`.
fn step(name: &str, only: &str, parameters: &[Value], after: &[String], job: &Job<'_>) -> Value {
    let mut arguments =
        vec!["run", "{{Param.Scene}}", "--only", only, "--out", "{{Param.Output}}", "--openjd"];
    if job.remote.is_some() {
        arguments.extend(["--remote", "{{Param.Server}}", "--remote-write"]);
    }
    let mut action = json!({
        "command": "{{Param.Program}}", "args": arguments,
        "cancelation": {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": NOTICE_S},
    });
    if let Some(seconds) = job.seconds {
        action["timeout"] = json!((PATIENCE * seconds).max(SHORTEST_LIMIT).ceil() as u64);
    }
    let mut amounts = vec![json!({"name": "amount.worker.vcpu", "min": job.cpus})];
    if let Some(bytes) = job.memory_bytes {
        let mebibytes = (bytes >> 20).div_ceil(MEMORY_STEP).max(1) * MEMORY_STEP;
        amounts.push(json!({"name": "amount.worker.memory", "min": mebibytes}));
    }
    let mut step = json!({
        "name": name, "script": {"actions": {"onRun": action}}, "hostRequirements": {"amounts": amounts},
    });
    if !parameters.is_empty() {
        step["parameterSpace"] = json!({"taskParameterDefinitions": parameters});
    }
    if !after.is_empty() {
        step["dependencies"] = after.iter().map(|name| json!({"dependsOn": name})).collect();
    }
    step
}

/// The task parameter of an axis: a range of whole numbers, or a list of texts.
fn parameter((axis, values): &(&str, Vec<&str>)) -> Result<Value, Error> {
    if let Some(range) = whole_range(values) {
        return Ok(json!({"name": axis, "type": "INT", "range": range}));
    }
    if values.len() > MOST_VALUES {
        let why = format!(
            "a job can list at most {MOST_VALUES} values of an axis, unless they are evenly spaced whole numbers"
        );
        return Err(Error::usage(format!("the axis `{axis}` has {} values: {why}", values.len())));
    }
    // These characters separate names and values in `--only`, or begin a parameter of the template.
    if let Some(value) = values.iter().find(|value| value.contains([',', '/', '{'])) {
        let why = "the values of a job cannot contain `,`, `/` or `{`";
        return Err(Error::usage(format!("the axis `{axis}` has the value `{value}`: {why}")));
    }
    Ok(json!({"name": axis, "type": "STRING", "range": values}))
}

/// Evenly spaced whole numbers as a range expression, such as `0-11` or `0-20:5`. `None` for any other values.
fn whole_range(values: &[&str]) -> Option<String> {
    let numbers = values.iter().map(|value| value.parse::<i64>().ok()).collect::<Option<Vec<_>>>()?;
    let (first, last) = (*numbers.first()?, *numbers.last()?);
    let step = numbers.get(1).map_or(1, |second| second - first);
    let is_even = step > 0 && numbers.windows(2).all(|pair| pair[1] - pair[0] == step);
    is_even.then(|| match (numbers.len(), step) {
        (1, _) => first.to_string(),
        (_, 1) => format!("{first}-{last}"),
        _ => format!("{first}-{last}:{step}"),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn even_numbers_are_ranges_and_other_values_are_lists() {
        for (values, range) in [
            (&["0", "1", "2"][..], Some("0-2")),
            (&["-5", "0", "5"], Some("-5-5:5")),
            (&["7"], Some("7")),
            (&["0", "1", "3"], None),
            (&["2", "1"], None),
            (&["0.5", "1.5"], None),
            (&["red"], None),
        ] {
            assert_eq!(whole_range(values).as_deref(), range, "{values:?}");
        }
        let many: Vec<String> = (0..1025).map(|n| format!("v{n}")).collect();
        let many: Vec<&str> = many.iter().map(String::as_str).collect();
        assert!(parameter(&("a", many.clone())).is_err());
        assert!(parameter(&("a", many[..1024].to_vec())).is_ok());
        for wrong in ["a,b", "a/b", "{{a}}"] {
            assert!(parameter(&("a", vec!["b", wrong])).is_err(), "{wrong}");
        }
    }

    /// Names of steps are at most as long as the specification allows, and differ between groups.
    #[test]
    fn steps_have_names_of_their_own() {
        let long = "n".repeat(65);
        let name = |names: &[&str], index| step_name(&names.iter().copied().collect(), index);
        assert_eq!(name(&["save"], 0), "save");
        assert_eq!(name(&["b", "a", "c"], 1), "a and 2 more");
        assert_eq!([name(&[&long], 2), name(&[&long[1..]], 3)], ["step 3", &long[1..]]);
    }
}
