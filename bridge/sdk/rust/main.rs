// main.rs: node @node@ as a program. Build: @build@
// Start: ./participant CHANNEL ... (a channel for each bus of table.c). No crate is needed.
use std::ffi::CString;
use std::os::raw::{c_char, c_int, c_void};
use std::os::unix::ffi::OsStringExt;

/// participant_t of participant.h, behind its functions.
#[repr(C)]
pub struct Participant {
    _private: [u8; 0],
}
/// participant_table_t, which table.c defines.
#[repr(C)]
pub struct Table {
    _private: [u8; 0],
}
type Step = extern "C" fn(*mut c_void, *mut Participant, f64, f64);

extern "C" {
    static TABLE: Table;
    fn participant_input(p: *const Participant, i: i32) -> *const f64;
    fn participant_output(p: *mut Participant, i: i32) -> *mut f64;
    fn participant_scale(p: *const Participant) -> f64;
    fn run_on_can(n: c_int, words: *const *const c_char, t: *const Table, s: Step, c: *mut c_void) -> c_int;
}

/// One slot of the node: the values of a message by its number in table.h, and how many it has.
pub struct Slot(*mut Participant);

impl Slot {
    pub fn input(&self, i: i32, n: usize) -> &[f64] {
        unsafe { std::slice::from_raw_parts(participant_input(self.0, i), n) }
    }
    pub fn output(&mut self, i: i32, n: usize) -> &mut [f64] {
        unsafe { std::slice::from_raw_parts_mut(participant_output(self.0, i), n) }
    }
    pub fn scale(&self) -> f64 {
        unsafe { participant_scale(self.0) }
    }
}

/// The law, once a slot of h seconds at the time t of the run. Received values are those accepted last.
#[allow(unused_variables, unused_mut)]
fn law(mut slot: Slot, t: f64, h: f64) {
    /* @law@ */
}

extern "C" fn step(_: *mut c_void, p: *mut Participant, t: f64, h: f64) {
    law(Slot(p), t, h);
}

fn main() {
    let words: Vec<CString> = std::env::args_os().map(|w| CString::new(w.into_vec()).unwrap()).collect();
    let mut pointers: Vec<*const c_char> = words.iter().map(|w| w.as_ptr()).collect();
    pointers.push(std::ptr::null());
    let n = words.len() as c_int;
    let code = unsafe { run_on_can(n, pointers.as_ptr(), &TABLE, step, std::ptr::null_mut()) };
    std::process::exit(code);
}
