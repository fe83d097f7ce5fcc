//! Descriptions of items, as lines: signatures without the names of arguments, without documentation and bodies.

use proc_macro2::{TokenStream, TokenTree};
use quote::ToTokens;
use syn::{Attribute, Fields, FnArg, ImplItem, Item, ReturnType, Signature, TraitItem, Type, Visibility};

use crate::source::Module;

/// Rust code in one line. Spaces remain between words and behind commas and semicolons.
fn code(tokens: impl ToTokens) -> String {
    let text = tokens.to_token_stream().to_string();
    let is_word = |c: char| c.is_alphanumeric() || c == '_';
    let mut line = String::new();
    let mut chars = text.chars().peekable();
    while let Some(c) = chars.next() {
        if !c.is_whitespace() {
            line.push(c);
            continue;
        }
        let (before, after) = (line.chars().next_back(), chars.peek());
        let joins_words = before.is_some_and(is_word) && after.is_some_and(|c| is_word(*c));
        if joins_words
            || before.is_some_and(|c| ",;".contains(c)) && after.is_some_and(|c| !c.is_whitespace())
        {
            line.push(' ');
        }
    }
    line
}

/// The derived traits, and attributes that forbid other crates something.
fn derived(attributes: &[Attribute]) -> String {
    let named = attributes
        .iter()
        .filter(|one| one.path().is_ident("derive") || one.path().is_ident("non_exhaustive"));
    named.map(|one| format!("{} ", code(&one.meta))).collect()
}

fn signature(sig: &Signature) -> String {
    let inputs: Vec<String> = sig
        .inputs
        .iter()
        .map(|input| match input {
            FnArg::Receiver(receiver) if receiver.reference.is_none() => "self".to_owned(),
            FnArg::Receiver(receiver) => code(receiver),
            FnArg::Typed(typed) => code(&typed.ty),
        })
        .collect();
    let output = match &sig.output {
        ReturnType::Default => String::new(),
        ReturnType::Type(_, ty) => format!(" -> {}", code(ty)),
    };
    let constness = if sig.constness.is_some() { "const " } else { "" };
    let bounds = sig.generics.where_clause.as_ref().map(|one| format!(" {}", code(one))).unwrap_or_default();
    format!("{constness}fn {}{}({}){output}{bounds}", sig.ident, code(&sig.generics), inputs.join(", "))
}

fn is_public(vis: &Visibility) -> bool {
    matches!(vis, Visibility::Public(_))
}

/// The public fields, and `..` if there are others.
fn fields(fields: &Fields) -> String {
    let shown = |field: &syn::Field| match &field.ident {
        Some(name) => format!("{name}: {}", code(&field.ty)),
        None => code(&field.ty),
    };
    let public: Vec<String> = fields.iter().filter(|field| is_public(&field.vis)).map(shown).collect();
    let others = fields.iter().any(|field| !is_public(&field.vis)).then(|| "..".to_owned());
    public.into_iter().chain(others).collect::<Vec<_>>().join(", ")
}

fn trait_item(item: &TraitItem) -> String {
    let default = |given: bool| if given { " [default]" } else { "" };
    match item {
        TraitItem::Const(one) => {
            format!("const {}: {}{}", one.ident, code(&one.ty), default(one.default.is_some()))
        }
        TraitItem::Fn(one) => format!("{}{}", signature(&one.sig), default(one.default.is_some())),
        TraitItem::Type(one) => {
            format!("type {}: {}{}", one.ident, code(&one.bounds), default(one.default.is_some()))
        }
        other => code(other),
    }
}

/// The patterns of a macro: what its arms accept.
fn patterns(body: &TokenStream) -> Vec<String> {
    let mut found = Vec::new();
    let mut tokens = body.clone().into_iter().peekable();
    while let Some(token) = tokens.next() {
        let follows = matches!(tokens.peek(), Some(TokenTree::Punct(next)) if next.as_char() == '=');
        if let (TokenTree::Group(group), true) = (token, follows) {
            found.push(format!("accepts {}", code(group.stream())));
        }
    }
    found
}

/// The public functions that a macro of the file declares for several types, as written in its body.
fn functions_in(tokens: TokenStream, found: &mut Vec<String>) {
    let tokens: Vec<TokenTree> = tokens.into_iter().collect();
    let is = |index: usize, word: &str| tokens.get(index).is_some_and(|token| token.to_string() == word);
    for (index, token) in tokens.iter().enumerate() {
        if is(index, "pub") && is(index + 1, "fn") {
            let head =
                tokens[index..].iter().take_while(|token| !token.to_string().starts_with('{')).cloned();
            found.push(code(head.collect::<TokenStream>()));
        } else if let TokenTree::Group(group) = token {
            functions_in(group.stream(), found);
        }
    }
}

fn is_type(ty: &Type, name: &str) -> bool {
    matches!(ty, Type::Path(path) if path.path.segments.last().is_some_and(|last| last.ident == name))
}

/// The description of the item `name`, which the module `place` defines: one line for the item, and one for each of its
/// parts.
pub fn describe(place: &Module, name: &str) -> Vec<String> {
    let mut lines = Vec::new();
    for item in &place.file().items {
        match item {
            Item::Const(one) if one.ident == name => lines.push(format!("const {name}: {}", code(&one.ty))),
            Item::Fn(one) if one.sig.ident == name => lines.push(signature(&one.sig)),
            Item::Type(one) if one.ident == name => {
                lines.push(format!("type{} = {}", code(&one.generics), code(&one.ty)));
            }
            Item::Struct(one) if one.ident == name => {
                let head = format!("struct{}", code(&one.generics));
                lines.push(format!("{}{head} {{ {} }}", derived(&one.attrs), fields(&one.fields)));
            }
            Item::Enum(one) if one.ident == name => {
                lines.push(format!("{}enum{}", derived(&one.attrs), code(&one.generics)));
                lines.extend(one.variants.iter().map(|variant| {
                    let values: Vec<String> = variant.fields.iter().map(code).collect();
                    format!("variant {}({})", variant.ident, values.join(", "))
                }));
            }
            Item::Trait(one) if one.ident == name => {
                lines.push(format!("trait{}: {}", code(&one.generics), code(&one.supertraits)));
                lines.extend(one.items.iter().map(trait_item));
            }
            Item::Macro(one) if one.ident.as_ref().is_some_and(|ident| ident == name) => {
                lines.extend(patterns(&one.mac.tokens));
            }
            _ => {}
        }
    }
    let is_type_here = lines.first().is_some_and(|line| line.contains("struct") || line.contains("enum"));
    if is_type_here {
        lines.extend(implementations(place, name));
    }
    lines
}

/// The calls of macros that declare items of the module.
pub fn macro_calls(place: &Module) -> Vec<String> {
    let calls = place.file().items.iter().filter_map(|item| match item {
        Item::Macro(one) if one.ident.is_none() => Some(one),
        _ => None,
    });
    calls.map(|one| format!("{}!({})", code(&one.mac.path), code(&one.mac.tokens))).collect()
}

/// The public functions of a type and the traits that it implements, in the whole crate; also those that macros in the
/// file of the type declare.
fn implementations(place: &Module, name: &str) -> Vec<String> {
    let mut lines = Vec::new();
    for item in place.files.iter().flat_map(|(_, file)| &file.items) {
        let Item::Impl(one) = item else { continue };
        if !is_type(&one.self_ty, name) {
            continue;
        }
        if let Some((_, of, _)) = &one.trait_ {
            lines.push(format!("impl {}", code(of)));
            continue;
        }
        for item in &one.items {
            match item {
                ImplItem::Fn(one) if is_public(&one.vis) => lines.push(signature(&one.sig)),
                ImplItem::Const(one) if is_public(&one.vis) => {
                    lines.push(format!("const {}: {}", one.ident, code(&one.ty)));
                }
                _ => {}
            }
        }
    }
    // Macros that declare functions of the type: these functions, and the types for which the macro is called.
    let macros = || {
        place
            .file()
            .items
            .iter()
            .filter_map(|item| if let Item::Macro(one) = item { Some(one) } else { None })
    };
    let is_for_type = |one: &&syn::ItemMacro| code(&one.mac.tokens).contains(&format!("impl {name}"));
    for declared in macros().filter(is_for_type) {
        functions_in(declared.mac.tokens.clone(), &mut lines);
        let calls = macros()
            .filter(|call| declared.ident.as_ref().is_some_and(|ident| call.mac.path.is_ident(ident)));
        lines.extend(calls.map(|call| format!("for {}", code(&call.mac.tokens))));
    }
    lines
}
