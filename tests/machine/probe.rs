use super::rig::Rig;
#[test]
fn probe() {
    let mut rig = Rig::with("$100=80\n$101=250\n$102=400\n$110=12000\n$111=12000\n$112=12000\n$120=5000\n$121=5000\n$122=5000\n");
    let mut t = String::from("G21 G91\nF60000\n");
    for _ in 0..38 { t += "G1 Z0.0001\n"; }
    rig.send(t.as_bytes());
    let ok = rig.run_until(5.0, |r| r.is_idle());
    println!("{ok} {:?} {}", rig.place, rig.seconds());
    println!("{}", rig.status());
    panic!();
}
