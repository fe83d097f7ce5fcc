//! Kinds that fail, wait, add notes or write files.

use super::*;

engine::params! {
    /// Passes a number on, or fails if it is too large.
    pub struct Refuse {
        /// The largest number that is passed on.
        above: f64 = 10.0, other("20.0");
    }
}
simple!(Refuse = "refuse", One, |params, inputs, _cx| {
    if inputs.value.0 > params.above {
        let message = format!("{} is more than {}", inputs.value.0, params.above);
        return Err(NodeError::new(message).at("above").hint("raise `above`"));
    }
    give(inputs.value.0)
});

engine::params! {
    /// Passes a number on and adds a note.
    pub struct Remark {
        /// True to mark the result as degraded.
        degraded: bool = false, other("true");
    }
}
impl Kind for Remark {
    const NAME: &'static str = "remark";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = One;
    type Out = Gives;
    fn run(params: &Self, inputs: One, _cx: &Context) -> Ran {
        let mut notes = Notes::none();
        notes.count("numbers", 1, "number seen");
        notes.warning("odd-number", format!("{} is odd", inputs.value.0));
        if params.degraded {
            notes.degraded("half-done", "only half of it");
        }
        Ok((Gives { number: Arc::new(Num(inputs.value.0)) }, notes))
    }
}

engine::params! {
    /// Waits for a given time and then passes a number on, unless it is cancelled.
    pub struct Slow {
        /// Duration.
        millis: u32 = 50, unit("ms"), inert("only the time differs"), other("1");
    }
}
simple!(
    Slow = "slow",
    One,
    |params, inputs, cx| {
        let start = Instant::now();
        while start.elapsed() < Duration::from_millis(params.millis.into()) {
            cx.check()?;
            std::thread::sleep(Duration::from_millis(1));
        }
        give(inputs.value.0)
    },
    fn work(params: &Self, _sizes: &Sizes) -> f64 {
        params.millis.into()
    }
);

engine::params! {
    /// Runs tiles that only sleep, and then passes a number on.
    pub struct Tiled {
        /// Number of tiles.
        tiles: u32 = 4, range(1, 100000), inert("only the time differs");
        /// Duration of each tile.
        millis: u32 = 1, unit("ms"), inert("only the time differs");
    }
}
simple!(
    Tiled = "tiled",
    One,
    |params, inputs, cx| {
        let pause = Duration::from_millis(params.millis.into());
        cx.for_each_tile(params.tiles as usize, |_| std::thread::sleep(pause))?;
        give(inputs.value.0)
    },
    fn work(params: &Self, _sizes: &Sizes) -> f64 {
        f64::from(params.tiles) * f64::from(params.millis)
    }
);

/// Number of [`Heavy`] nodes that are running now, and the maximum of this number so far.
pub static HEAVY: (AtomicUsize, AtomicUsize) = (AtomicUsize::new(0), AtomicUsize::new(0));

engine::params! {
    /// Passes a number on, and estimates that this needs a large amount of memory.
    pub struct Heavy {
        /// Estimated memory.
        megabytes: u32 = 1, unit("MB"), inert("claims memory only"), other("2");
    }
}
simple!(
    Heavy = "heavy",
    One,
    |_params, inputs, _cx| {
        let now = HEAVY.0.fetch_add(1, Ordering::SeqCst) + 1;
        HEAVY.1.fetch_max(now, Ordering::SeqCst);
        std::thread::sleep(Duration::from_millis(20));
        HEAVY.0.fetch_sub(1, Ordering::SeqCst);
        give(inputs.value.0)
    },
    fn estimate(params: &Self, _inputs: &One) -> Cost {
        Cost { bytes: u64::from(params.megabytes) << 20 }
    }
);

engine::params! {
    /// Panics unless its input is zero.
    pub struct Panic {
        /// True to panic in the estimate, before the code runs.
        early: bool = false, other("true");
    }
}
simple!(
    Panic = "panic",
    One,
    |_params, inputs, _cx| {
        assert!(inputs.value.0 == 0.0, "no {} here", inputs.value.0);
        give(0.0)
    },
    fn estimate(params: &Self, _inputs: &One) -> Cost {
        assert!(!params.early, "no estimate");
        Cost::default()
    }
);

static DRIFTS: AtomicUsize = AtomicUsize::new(0);

engine::params! {
    /// Returns a different number each time it runs, which no kind is permitted to do.
    pub struct Drift {}
}
simple!(
    Drift = "drift",
    One,
    |_params, _inputs, _cx| give(DRIFTS.fetch_add(1, Ordering::SeqCst) as f64),
    const STORE: Keep = Keep::Cheap;
);

engine::params! {
    /// Writes numbers to text files.
    pub struct WriteNumber {
        /// The file.
        path: OutputFile, other("\"b.txt\"");
        /// If true, each number is written to its own file; otherwise all numbers are written to one file.
        each: bool = false, other("true");
        /// Names of the views; by default `a`, `b` and so on.
        views: Vec<String> = Vec::new(), other("[\"x\"]");
    }
}
engine::inputs! { /** Numbers. */ pub struct Written { /** The numbers. */ number: Vec<Arc<Num>>, } }
engine::outputs! { /** Files. */ pub struct Writes { /** The files. */ files: Arc<Files>, } }
impl Kind for WriteNumber {
    const NAME: &'static str = "write-number";
    const VERSION: u32 = 1;
    type Params = Self;
    type In = Written;
    type Out = Writes;
    fn run(params: &Self, inputs: Written, _cx: &Context) -> Ran<Writes> {
        let text: Vec<String> = inputs.number.iter().map(|number| format!("{:?}\n", number.0)).collect();
        let files = if params.each {
            let letters = ('a'..='z').map(String::from);
            let views = params.views.iter().cloned().chain(letters.skip(params.views.len()));
            views.zip(text).map(|(view, text)| FileBytes { view, bytes: text.into_bytes() }).collect()
        } else {
            vec![FileBytes { view: String::new(), bytes: text.concat().into_bytes() }]
        };
        Ok((Writes { files: Arc::new(Files(files)) }, Notes::none()))
    }
}

engine::params! {
    /// Writes the recipe of its input to a file.
    pub struct WriteRecipe {
        /// The file.
        path: OutputFile, other("\"b.txt\"");
    }
}
impl Kind for WriteRecipe {
    const NAME: &'static str = "write-recipe";
    const VERSION: u32 = 1;
    const READS: &'static [ContextField] = &[ContextField::Recipe];
    type Params = Self;
    type In = Written;
    type Out = Writes;
    fn run(_params: &Self, _inputs: Written, cx: &Context) -> Ran<Writes> {
        let bytes = cx.recipe().unwrap_or_default().as_bytes().to_vec();
        Ok((Writes { files: Arc::new(Files(vec![FileBytes { view: String::new(), bytes }])) }, Notes::none()))
    }
}
