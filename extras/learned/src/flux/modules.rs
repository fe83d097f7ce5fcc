//! The linear layers of a model, and how a layout splits their rows.

use super::config::Config;

/// The name, number of rows and number of columns of every linear layer of a model with these sizes.
pub fn linears(config: &Config) -> Vec<(String, usize, usize)> {
    let Config { hidden, mlp, .. } = *config;
    let mut list = vec![
        ("img_in".to_owned(), hidden, config.in_channels),
        ("txt_in".to_owned(), hidden, config.context),
        ("final_layer.adaLN_modulation.1".to_owned(), 2 * hidden, hidden),
        ("final_layer.linear".to_owned(), config.in_channels, hidden),
    ];
    let embedders = [("time_in", config.time), ("vector_in", config.pooled)];
    let guidance = config.guidance.then_some(("guidance_in", config.time));
    for (name, columns) in embedders.into_iter().chain(guidance) {
        list.push((format!("{name}.in_layer"), hidden, columns));
        list.push((format!("{name}.out_layer"), hidden, hidden));
    }
    for block in 0..config.double_blocks {
        for side in ["img", "txt"] {
            let name = |part: &str| format!("double_blocks.{block}.{side}_{part}");
            list.push((name("mod.lin"), 6 * hidden, hidden));
            list.push((name("attn.qkv"), 3 * hidden, hidden));
            list.push((name("attn.proj"), hidden, hidden));
            list.push((name("mlp.0"), mlp, hidden));
            list.push((name("mlp.2"), hidden, mlp));
        }
    }
    for block in 0..config.single_blocks {
        let name = |part: &str| format!("single_blocks.{block}.{part}");
        list.push((name("modulation.lin"), 3 * hidden, hidden));
        list.push((name("linear1"), 3 * hidden + mlp, hidden));
        list.push((name("linear2"), hidden, hidden + mlp));
    }
    list
}

/// The number of rows of each piece of a module that the layout of `diffusers` splits into `pieces` pieces. Each
/// piece has `hidden` rows, except the last piece, which has all remaining rows.
pub fn piece_rows(config: &Config, rows: usize, pieces: usize) -> Vec<usize> {
    if pieces == 1 {
        return vec![rows];
    }
    let mut list = vec![config.hidden; 3];
    if pieces == 4 {
        list.push(rows - 3 * config.hidden);
    }
    list
}

#[cfg(test)]
mod tests {
    use super::super::names::Layout;
    use super::*;

    #[test]
    fn no_two_modules_share_a_name_in_either_layout() {
        let config = Config::kontext();
        for layout in [Layout::Original { prefix: "" }, Layout::Diffusers] {
            let all: Vec<String> =
                linears(&config).iter().flat_map(|(name, ..)| layout.pieces(name).modules).collect();
            let mut unique = all.clone();
            unique.sort();
            unique.dedup();
            assert_eq!(unique.len(), all.len());
        }
    }

    #[test]
    fn pieces_are_named_and_fill_their_rows() {
        let config = Config::kontext();
        let pieces = Layout::Diffusers.pieces("single_blocks.7.linear1");
        let block = "single_transformer_blocks.7";
        let parts = ["attn.to_q", "attn.to_k", "attn.to_v", "proj_mlp"];
        assert_eq!(pieces.modules, parts.map(|part| format!("{block}.{part}")));
        for (name, rows, _) in linears(&config) {
            let pieces = Layout::Diffusers.pieces(&name);
            assert_eq!(piece_rows(&config, rows, pieces.modules.len()).iter().sum::<usize>(), rows, "{name}");
            assert_eq!(pieces.swapped, name == "final_layer.adaLN_modulation.1");
        }
    }
}
