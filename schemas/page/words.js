// The words of the page, in the languages of its users. The names of states and reasons are those of the command line.

const EN = {
  fleet: "Fleet", wall: "Wall", stop: "STOP", stop_all: "STOP ALL", other_language: "中文",
  linked: "connected", not_linked: "not connected", no_desk: "no connection to the desk: nothing here is current",
  unlinked: "The desk is not connected to Zenoh and sees no robot. Robots may be moving. Look at them; use the button on the robot.",
  no_contact: "No contact with $1 for $2 s. It may be moving. Look at it; use the button on the robot.",
  desk_lost: "No contact with the desk for $1 s. Robots may be moving. Look at them; use the button on the robot.",
  stopped_by: "stopped by $1", reset_of: "Reset the stop of $1",
  in_control: "$1 is in control", in_control_here: "you are in control", since: "since $1",
  search: "Search robots", all: "all", needs_person: "needs a person", robots: "robots", one_robot: "robot", unseen: "not acknowledged",
  acknowledge: "Acknowledge", seen_by: "acknowledged by",
  robot: "Robot", state: "State", driver: "Driver", speed: "Speed", limit: "Limit", link_age: "Link", lost: "Lost frames", lost_samples: "lost", what: "What",
  no_robot: "No robots.",
  too_many: "There are more robots or recorders than the desk can show: only the first ones are listed. STOP ALL reaches all of them. If you do not have that many, there is an unknown device on the network.", recorders: "Recorders", free: "free", last_event: "last event",
  blockers: "Blockers", cure: "Cure",
  speed_chart: "Speed, m/s", angle_chart: "Steering angle, degrees", asked: "requested", told: "commanded", measured: "measured",
  path: "Path by odometry", forward: "forward", left: "left", events: "Events", no_events: "none", facts: "Chassis",
  mode: "Mode", gear: "Gear", braking: "Brake", parking: "Parking brake", bumpers: "Bumpers", lamps: "Lamps", mileage: "Mileage",
  silent_frames: "Silent frames", none: "none", clear: "clear", front: "front", rear: "rear", off: "off", headlamp: "headlamp",
  left_lamp: "left", right_lamp: "right", horn: "horn", latched: "Latched", age: "age", obeys_none: "no commands", link_more: " (p99 $1 ms), timeout $2 ms, reaction distance $3 m",
  stopping_now: "Stop sent to", stop_outcome: "Stop", everyone: "all robots", standing: "stopped and latched (measured)",
  refused: "cannot stop", unconfirmed: "not confirmed stopped", silent_robot: "no reply: not confirmed stopped", nobody_replied: "No robot replied.",
  no_outcome: "The desk did not report the outcome: no robot is confirmed stopped.",
  uncounted: "The list of connected robots is incomplete: there may be more.", not_sent: "NOT SENT: there is no connection to the desk",
  control: "Drive", take_control: "Take control", take_over: "Take over from", give_back: "Give back", reset: "Reset", top_speed: "Speed",
  logs: "Logs", download: "Download", uncataloged: "Not in the catalog yet",
  sees: "No grant: you can see and stop all robots.", supervisor: "supervisor", operator: "operator", program: "program",
  maintainer: "maintainer, cannot drive", at_most: "at most", until: "until", lights: "Lights", sound_horn: "Horn",
  hold: "Hold to drive: up is forward. Keys: arrows, W A S D, U O M . for curves; gamepad: hold the right shoulder button. Let go to stop. Esc is the remote stop.",
  ask_name: "You drive as $1. Others see this name, and it is recorded. Type your name, then take control.",
  name_form: "A name has 1 to 64 letters, digits, dots, hyphens or underscores.",
  pad: "Hold to drive", no_pad: "Not in control", your_name: "Your name", open_mode: "Open mode: anyone may drive, under any name.", signed_as: "Signs as", keys: "Keys",
  key_help: "In signed mode this browser signs commands with a key that never leaves it. Save the request, have it signed with 'cruiser provision sign', then load the bundle.",
  save_request: "Save request", load_bundle: "Load bundle", take_over_bundle: "The fingerprints match: accept", forget: "Forget the grant", request: "request", authority: "authority",
  compare_request: "'cruiser provision sign' must show the same fingerprint; otherwise the file was changed on the way.",
  compare_authority: "Before you accept, compare the authority's fingerprint with the output of 'cruiser provision authority'.", insecure: "Keys work only on this machine or over HTTPS.",
  needs_key: "This robot accepts only signed commands: save a request under Keys, have it signed, then load the bundle.",
  you_drive: "You are driving.", ended: "You are no longer driving", working: "…",
  report: "Report", open_in: "Open in", open_it: "Open", why: "Why", logs_of: "Logs of $1", find_it: "Find", find_what: "Search for", incidents_and_logs: "incidents and logs",
  find_robot: "Robot", find_reason: "Reason", find_operator: "Operator", find_since: "Since", find_until: "Until", nothing_found: "Nothing found.", no_server: "no connection to the desk",
  time: "Time (UTC)", lasted: "Lasted", distance: "Distance", kind: "Kind", operator_of: "Operator", drives: "Drives", stops: "Stops", incidents: "Incidents", samples_lost: "Lost samples", reading_logs: "reading logs …",
  close: "Close", stop_mark: ". ", use_button: "If a robot is not confirmed stopped, use the button on it.",
  word: {
    offline: "offline", needs_reset: "stopped - needs reset", bus_down: "bus down", stopping: "stopping", remote_control: "remote control", blocked: "blocked",
    driving: "driving", in_control: "in control", ready: "ready", telemetry: "telemetry only",
  },
  counted: { needs_reset: ["needs reset", "need reset"] },
  reason: {},
  of_robot: {},
  value: { fully_braked: "fully braked" },
};

const ZH = {
  fleet: "车队", wall: "大屏", stop: "停车", stop_all: "全部停车", other_language: "English",
  linked: "已连接", not_linked: "未连接", no_desk: "与控制台的连接已断开：页面内容不是最新",
  unlinked: "控制台没有连接到 Zenoh，收不到任何机器人的数据。机器人可能正在移动：请看着它们，使用车身上的急停按钮。",
  no_contact: "与 $1 失去联系已 $2 秒。它可能正在移动：请看着它，使用车身上的急停按钮。",
  desk_lost: "与控制台失去联系已 $1 秒。机器人可能正在移动：请看着它们，使用车身上的急停按钮。",
  stopped_by: "停车者：$1", reset_of: "复位 $1 的停车",
  in_control: "$1 持有控制权", in_control_here: "您持有控制权", since: "自 $1",
  search: "搜索机器人", all: "全部", needs_person: "需要处理", robots: "台机器人", one_robot: "台机器人", unseen: "台未确认",
  acknowledge: "确认", seen_by: "已确认：",
  robot: "机器人", state: "状态", driver: "驾驶者", speed: "速度", limit: "限速", link_age: "链路", lost: "丢帧", lost_samples: "丢失", what: "说明",
  no_robot: "没有收到任何机器人的数据。",
  too_many: "收到的机器人或记录器多于控制台能显示的数量：只显示最先出现的。“全部停车”对所有机器人有效。如果实际没有这么多，说明网络上有陌生设备。", recorders: "记录器", free: "剩余", last_event: "最近事件",
  blockers: "阻碍行驶的因素", cure: "处理办法",
  speed_chart: "速度，米/秒", angle_chart: "转向角，度", asked: "请求", told: "指令", measured: "实测",
  path: "里程计轨迹", forward: "前", left: "左", events: "事件", no_events: "无", facts: "底盘",
  mode: "模式", gear: "挡位", braking: "制动", parking: "驻车制动", bumpers: "防撞条", lamps: "灯光", mileage: "里程",
  silent_frames: "缺失的帧", none: "无", clear: "未触发", front: "前", rear: "后", off: "关", headlamp: "前照灯",
  left_lamp: "左转", right_lamp: "右转", horn: "喇叭", latched: "锁定", age: "已过", obeys_none: "未执行任何指令", link_more: "（p99 $1 ms），超时 $2 ms，反应距离 $3 m",
  stopping_now: "已发送停车指令：", stop_outcome: "停车", everyone: "全部机器人", standing: "已停稳并锁定（实测）",
  refused: "无法停车", unconfirmed: "未见停稳", silent_robot: "没有应答：不知道是否停稳", nobody_replied: "没有机器人应答。",
  no_outcome: "控制台没有回报结果：不知道是否停稳。",
  uncounted: "无法确定有哪些机器人在线：可能还有其他机器人。", not_sent: "未发送：与控制台没有连接",
  control: "驾驶", take_control: "取得控制权", take_over: "从此人接管：", give_back: "交还控制权", reset: "复位", top_speed: "速度",
  logs: "日志", download: "下载", uncataloged: "尚未编入目录",
  sees: "没有授权：可以查看和停车。", supervisor: "主管", operator: "操作员", program: "程序",
  maintainer: "维护员，不能驾驶", at_most: "最高", until: "有效期至", lights: "灯光", sound_horn: "鸣笛",
  hold: "按住行驶：上为前进。方向键，W A S D，U O M . 转弯；手柄须按住右肩键。松开即停。Esc 为远程停车。",
  ask_name: "您将以 $1 的名字驾驶：别人会看到这个名字，日志也会保存。请填写您的名字，再取得控制权。",
  name_form: "名字由 1 到 64 个字母、数字、点、连字符或下划线组成。",
  pad: "按住行驶", no_pad: "尚未取得控制权", your_name: "您的名字", open_mode: "开放模式：任何人都可以用任意名字驾驶。", signed_as: "签名者：", keys: "密钥",
  key_help: "在签名模式下，本浏览器用不可导出的密钥签名。保存请求，用 'cruiser provision sign' 签发，再载入签发文件。",
  save_request: "保存请求", load_bundle: "载入签发文件", take_over_bundle: "一致：接受", forget: "删除授权", request: "请求", authority: "授权方",
  compare_request: "'cruiser provision sign' 应显示相同的指纹，否则文件在途中被改过。",
  compare_authority: "接受之前，请与 'cruiser provision authority' 显示的授权方指纹核对。", insecure: "密钥功能需要本机页面或 HTTPS。",
  needs_key: "此机器人只接受签名指令：请在“密钥”中保存请求，签发后载入。",
  you_drive: "您正在驾驶。", ended: "您已不再驾驶", working: "…",
  report: "报告", open_in: "打开方式：", open_it: "打开", why: "原因", logs_of: "$1 的日志", find_it: "查找", find_what: "查找什么", incidents_and_logs: "事故记录和日志",
  find_robot: "机器人", find_reason: "原因", find_operator: "操作员", find_since: "从", find_until: "到", nothing_found: "日志中没有。", no_server: "与控制台的连接已断开",
  time: "时间（UTC）", lasted: "时长", distance: "距离", kind: "种类", operator_of: "操作员", drives: "行驶", stops: "停车", incidents: "事故记录", samples_lost: "丢失的样本", reading_logs: "正在读取日志……",
  close: "关闭", stop_mark: "。", use_button: "不能确认停稳的机器人，请按下车身上的急停按钮。",
  word: {
    offline: "离线", needs_reset: "已停车，须复位", bus_down: "总线断开", stopping: "停车中", remote_control: "遥控器控制", blocked: "受阻",
    driving: "行驶中", in_control: "受控", ready: "就绪", telemetry: "仅遥测",
  },
  counted: {},
  // Meaning and cure of each reason, with this page's buttons. ROBOT stands for the robot's name.
  reason: {
    none: ["没有异常", ""],
    malformed: ["请求不符合规定的格式", "只发送格式规定的字段；客户端较新时，网关可能也需要更新"],
    too_large: ["请求超过允许的长度", "只发送格式规定的字段"],
    unknown_verb: ["没有这个命令，或者请求的方式不对", "见 docs/commands.md 中的命令表"],
    busy: ["同样的操作正在进行，或者同时的请求太多", "稍候再试"],
    no_lease: ["控制权编号无效", "按“取得控制权”"],
    lease_held: ["控制权在他人手中", "等对方交还，或者按“请求移交”“从此人接管”"],
    role_too_low: ["持有者的角色更高", "请持有者移交，或者以更高的角色接管"],
    lease_taken: ["控制权已被他人接管", "请对方移交，或者按“从此人接管”取回"],
    lease_released: ["控制权已交还", "按“取得控制权”"],
    lease_expired: ["控制权没有及时续期，已经失效", "按“取得控制权”；自己编写的客户端须自行续期"],
    sequence: ["序号没有递增，或者跳得太多", "同一次控制权内，每条行驶指令的 seq 从 0 或 1 起逐条加 1"],
    challenge_unknown: ["指令所带的随机数不是最近发布的，无法知道指令有多旧", "使用 safety/state 中最新的随机数"],
    too_old: ["指令太旧", "使用 safety/state 中最新的随机数；改善链路"],
    deadman: ["没有及时收到有效的行驶指令", "保持行驶指令不中断，然后按“取得控制权”"],
    not_engaged: ["机器人未接合", "按“取得控制权”"],
    engaging: ["机器人正在接合", "等到显示“已接合”"],
    already_engaged: ["机器人已经接合", "直接驾驶，或者先按“交还控制权”"],
    stopping: ["正在停车", "等停车过程结束"],
    moving: ["机器人在移动", "等它停稳"],
    parked: ["驻车制动已施加", "先交还控制权，再按“取得控制权”：驻车制动会随之释放"],
    gear_shifting: ["正在换挡，或正在释放驻车制动", "稍候"],
    command_not_zero: ["行驶指令不为零", "松开按键和操纵区"],
    not_confirmed: ["底盘没有及时确认", "检查底盘及其反馈"],
    disengaged: ["持有者已脱开", "按“取得控制权”"],
    bus_down: ["CAN 总线不可用", "用 'cruiser list' 查看原因（gateway/health）"],
    bus_off: ["CAN 控制器因错误过多而离线（bus-off）", "检查线缆、终端电阻和波特率；设置了 restart-ms 时接口会自行恢复"],
    bus_errors: ["CAN 控制器的错误状态有变化", "检查线缆、终端电阻和波特率"],
    feedback_missing: ["缺少底盘反馈", "在“底盘”一栏查看缺失的帧"],
    feedback_faulty: ["底盘反馈的校验和或计数器有错", "用 'cruiser list --json' 查看是哪些帧（gateway/health）；检查线缆和终端电阻"],
    feedback_late: ["报文来得比网关读得快，看到的已经过时", "查找向总线大量发送的节点，检查处理器负载"],
    variant_unknown: ["固件版本及其速度比例尚未确定", "让机器人静止并保持总线反馈；如果本来就静止，则是 chassis.variant 设置有误"],
    hand_transmitter: ["遥控器正在控制机器人", "把遥控器的 SA 拨杆拨到指令控制模式，然后按“取得控制权”"],
    mode_not_auto: ["底盘不在自动模式", "检查机器人上的急停按钮和遥控器，然后按“取得控制权”"],
    front_bumper: ["前防撞条被撞", "按“复位”，再按“取得控制权”并后退，直到离开障碍物；前后防撞条都被压住时，用人力或遥控器把机器人移开"],
    rear_bumper: ["后防撞条被撞", "按“复位”，再按“取得控制权”并前进，直到离开障碍物；前后防撞条都被压住时，用人力或遥控器把机器人移开"],
    implausible_speed: ["实测的各个速度彼此不符，或与指令不符", "检查车轮和 chassis.variant 的设置；然后按“复位”，然后按“取得控制权”"],
    found_moving: ["没有指令却在移动", "查明是什么使它移动，检查驻车制动，然后按“取得控制权”"],
    other_commander: ["另一台计算机正在总线上控制底盘", "停掉另一台，然后按“取得控制权”"],
    remote_stop: ["收到远程停车", "按“复位”，然后按“取得控制权”"],
    loop_late: ["网关的控制循环迟到", "检查处理器负载，然后按“取得控制权”"],
    send_failed: ["总线不接收网关的报文", "检查线缆、终端电阻和总线负载，然后按“取得控制权”"],
    gate: ["总线前的最后一道检查拒绝了一帧：网关自身的故障", "排除原因，按“复位”，然后按“取得控制权”"],
    guard: ["看护进程代替网关停了车", "排除原因，按“复位”，然后按“取得控制权”"],
    unguarded: ["没有看护进程看着网关：尚未启动，或此接口不支持", "等一秒；否则换用多个进程可以同时打开的接口，或者用 gateway.accept_unguarded 表示接受"],
    shutdown: ["网关正在关闭", "等它重新启动"],
    link_too_slow: ["链路太慢，不能驾驶", "换用更快的链路，并使用 safety/state 中最新的随机数"],
    no_realtime: ["网关没有实时优先级：处理器繁忙时它可能被延误，直到看护进程停车，因此限速较低", "像 deploy/cruiser-gateway.service 那样运行（LimitRTPRIO=20），或在 /etc/security/limits.conf 中允许（USER - rtprio 20），并使 gateway.realtime_priority 大于 0"],
    rolling: ["没有指令却在移动，或与指令反向移动：已施加驻车制动", "检查是否坡度太陡、电机无力或有人推动；然后按“复位”，再按“取得控制权”"],
    overspeed: ["机器人超过限速", "排除原因，按“复位”，然后按“取得控制权”"],
    steering: ["转向没有跟随指令", "排除原因，按“复位”，然后按“取得控制权”"],
    feedback_frozen: ["底盘反馈已冻结，而其他反馈或指令表明机器人在移动", "排除原因，按“复位”，然后按“取得控制权”"],
    unauthenticated: ["其他计算机能够访问网关，而网关不知道是谁在指挥", "用 'cruiser provision robot ROBOT' 生成密钥，并把 authority.mode 设为 signed；或者只监听和连接 127.0.0.1"],
    self_test: ["网关自己的密钥或访问控制有问题", "处理 'cruiser why ROBOT' 指出的问题；文件更换后网关会重新读取"],
    authority_stale: ["太久没有收到授权方的消息，无法得知最近撤销了哪些授权", "升级机器人：本版本不依赖授权方的消息"],
    proof_missing: ["请求没有签名", "用操作员的密钥来指挥：见 docs/authority.md"],
    proof_wrong: ["签名与请求不符", "用授权所属的密钥签名，原样发给签名所指的机器人：见 docs/authority.md"],
    replayed: ["同样的内容以前收到过", "每个请求都要重新签名"],
    grant_unknown: ["机器人不认识这份授权或其授权方", "向它出示授权及其证书链（查询 @auth）"],
    grant_expired: ["授权已过期，或尚未生效", "向站点申请新的授权"],
    grant_revoked: ["授权已被撤销", "询问车队的授权方"],
    not_granted: ["授权不允许此操作", "申请允许此操作的授权"],
    not_moving: ["指令要求行驶，却没有看到机器人移动", "查看是什么挡住了它，它是否在移动而速度读数为零；然后按“复位”，再按“取得控制权”"],
    brake_slips: ["驻车制动显示已施加，却拉不住机器人：只有电机拉住它", "垫住车轮，或用遥控器把它开到平地；制动静止 5 秒后按“复位”；下次上坡前修好制动"],
    stopped_by_other: ["别人停下了机器人，可能就站在它前面", "先问那个人，再按“复位”"],
    idle: ["太久没有收到带速度的行驶指令，机器人已退出接合", "按“取得控制权”"],
  },
  // Reasons whose text differs for a robot, as opposed to a request.
  of_robot: {
    no_lease: ["没有人持有控制权", "按“取得控制权”"],
    grant_expired: ["机器人自己的授权已过期，或尚未生效", "时钟不准就校正时钟；否则：在机器人上 'cruiser provision renew robot'，在授权方 'sign'，再 'install --replace'"],
    grant_revoked: ["机器人自己的授权已被撤销", "如果授权方已更换：在机器人上 'cruiser provision renew robot'，在授权方 'sign'，再 'install --replace --fingerprint F'；否则询问授权方"],
    grant_unknown: ["机器人自己的授权不是它所认识的授权方签发的", "重新接纳它：在机器人上 'cruiser provision renew robot'，在授权方 'sign'，再 'install --replace --fingerprint F'"],
  },
  // Sentences of robots, by kind of event: $1 is a part as sent, {1} one that is translated too.
  event: {
    lease: [
      [/^(\S+) has acquired the lease as (\w+)$/, "$1 取得了控制权（{2}）"],
      [/^(\S+) has taken the lease as (\w+)$/, "$1 接管了控制权（{2}）"],
      [/^(\S+) took the lease from (\S+)$/, "$1 从 $2 手中接管了控制权"],
      [/^(\S+) gave the lease back$/, "$1 交还了控制权"],
      [/^the lease of (\S+) expired$/, "$1 的控制权已失效"],
      [/^(\S+) lost the lease: (.+)$/, "$1 失去控制权：{2}"],
    ],
    engaged: [[/^engaged: the chassis reads auto$/, "已接合：底盘处于自动模式"]],
    stop: [[/^stopping: (.+)$/, "停车：{1}"]],
    stopped: [[/^stopped: (.+)$/, "停车结束：{1}"]],
    latch: [[/^latched until a reset: (.+)$/, "已锁定，须复位：{1}"]],
    reset: [[/^reset: (.+)$/, "复位：{1}"]],
    takeover: [[/^commanding ended: (.+)$/, "不再发送指令：{1}"]],
    fault: [
      [/^the loop was (\d+) ms late$/, "控制循环迟到 $1 ms"],
      [/^the CAN controller: (\w+) before, (\w+) now$/, "CAN 控制器：之前{1}，现在{2}"],
      [/^the parking brake does not read applied; the motor holds the robot in gear until it does$/, "没有读到驻车制动已施加；在此之前由电机在挡位上保持机器人"],
      [/^the gateway starts again, with renewed keys and certificates$/, "网关以更新后的密钥和证书重新启动"],
    ],
    guard: [[/^the guard's stop has ended: (.+)$/, "看护进程的停车已结束：{1}"]],
    gateway: [[/^shutting down$/, "网关正在关闭"]],
  },
  // Parts of these, and other fixed sentences of robots and the desk.
  said: [
    [/^by (\S+)$/, "由 $1"], [/^by (\d+) ms$/, "迟到 $1 ms"], [/^none for (\d+) ms$/, "$1 ms 没有指令"], [/^(\w+) \((.+)\)$/, "{1}（{2}）"],
    [/^nothing was latched$/, "没有锁定项"], [/^the chassis did not switch to mode auto$/, "底盘没有切换到自动模式"],
    [/^at standstill, no commands sent$/, "已停稳，不再发送指令"], [/^no commands sent, but (.+)$/, "不再发送指令，但{1}"], [/^another computer commands the robot and can move it$/, "另一台计算机在控制机器人，可能使它移动"],
    [/^it may execute an earlier command$/, "它可能执行以前的指令"], [/^an earlier stop could not be carried out$/, "之前的停车未能执行"],
    [/^the gateway's loop gave no sign of life$/, "网关的控制循环没有响应"], [/^the gateway could not send$/, "网关无法发送"], [/^the gateway is gone$/, "网关已消失"], [/^the robot stands$/, "机器人已停稳"], [/^the robot is not seen to stand$/, "未见机器人停稳"],
    [/^((?:last stop|ramp|brake|neutral|park|hold|motor|disable): [^(]+) \((.+)\)$/, "{1}（{2}）"], [/^(ramp|brake|neutral|park|hold|motor|disable): (.+)$/, "{1}，原因：{2}"],
    [/^last stop: (.+)$/, "上次停车：{1}"], [/^no operator holds the lease$/, "无人持有控制权"],
    [/^(\S+) holds the lease as (\w+), expires in ([\d.]+) s$/, "$1 持有控制权（{2}），$3 s 后到期"],
    [/^mode (\w+)$/, "模式：{1}"], [/^it takes no commands$/, "不接受指令"],
    [/^no state yet$/, "尚无状态"], [/^no contact for (\S+ \w+)$/, "失去联系已 $1"], [/^this end is not connected to Zenoh$/, "本端未连接到 Zenoh"],
    [/^its gateway is not connected$/, "网关未连接"], [/^its gateway is connected, but sends no health$/, "网关已连接，但不发送健康状况"],
    [/^its gateway is connected and sends health$/, "网关已连接，并在发送健康状况"],
    [/^it replied that it stops, but (.+)$/, "它应答会停车，但{1}"], [/^its safety\/state does not show it$/, "它的 safety/state 没有这样显示"],
    [/^its safety\/state shows it too briefly$/, "它的 safety/state 这样显示的时间太短"], [/^its speed is unknown$/, "看不到它的速度"],
    [/^it has stood too briefly$/, "看到它静止的时间太短"], [/^it moves at ([\d.]+) m\/s$/, "它在以 $1 m/s 移动"], [/^its speed reads 0, not confirmed by feedback$/, "速度读数为零，但没有反馈确认"],
    [/^(\S+) does not answer (\w+)$/, "$1 没有应答 $2"], [/^(\S+): no reply$/, "$1：没有应答"], [/^given up$/, "已放弃"],
    [/^no contact with the desk$/, "与控制台失去联系"], [/^no contact with (\S+)$/, "与 $1 失去联系"],
    [/^no state to believe comes from (\S+)$/, "收不到 $1 的可信状态"], [/^the reply is not the robot's$/, "应答不是这台机器人发出的"],
    [/^the replies contradict each other: another gateway of this name, or an impostor, is there$/, "各个应答互相矛盾：有另一个同名的网关，或有人冒充"],
    [/^the robot's grant is not one statement of the authority$/, "机器人的授权不是授权方的一份声明"], [/^the grant is of (\w+) (\S+), not of robot (\S+)$/, "授权属于 $1 $2，而不是机器人 $3"],
    [/^the grant cannot be read$/, "授权无法读取"],
    [/^the grant is of another authority$/, "授权来自另一个授权方"], [/^the signature of the grant does not fit$/, "授权的签名不符"],
    [/^the grant has expired or is not valid yet$/, "授权已过期，或尚未生效"], [/^the grant is of (\w+) (\S+)$/, "授权属于 $1 $2"],
    [/^the bundle is not signed$/, "签发文件没有签名"], [/^the bundle was changed after it was signed$/, "签发文件在签名之后被改过"],
    [/^the bundle names no authority$/, "签发文件没有写明授权方"], [/^the bundle is not signed by the authority that it names$/, "签发文件不是由其中写明的授权方签名的"],
    [/^this is no bundle of an operator$/, "这不是操作员的签发文件"], [/^this bundle is for another key$/, "这份签发文件属于另一个密钥"],
  ],
  value: {
    undefined: "未定义", auto: "自动", remote: "遥控", stop: "停止", park: "驻车", reverse: "倒挡", neutral: "空挡", drive: "前进挡",
    released: "已释放", braking: "制动中", fully_braked: "完全制动", applied: "已施加",
    standby: "待命", engaging: "正在接合", engaged: "已接合", ramp: "减速", brake: "制动", hold: "保持制动", motor: "电机保持", disable: "停止输出",
    unknown: "未知", active: "正常", warning: "警告", passive: "被动", bus_off: "离线（bus-off）", recording: "记录中", stopped: "已停止", full: "空间用完",
    operator: "操作员", supervisor: "主管", program: "程序",
    lease: "控制权", latch: "锁定", reset: "复位", takeover: "接管", fault: "故障", guard: "看护", refusal: "拒绝", request: "请求",
    gateway: "网关", recorder: "记录器", gap: "缺失", clock: "时钟", incident: "事故记录",
  },
};

let words = (localStorage.getItem("language") ?? navigator.language).startsWith("zh") ? ZH : EN;

/** A text of the page; $1 and so on are these parts. */
export const t = (name, ...parts) => (words[name] ?? EN[name] ?? name).replace(/\$(\d)/g, (_, at) => parts[at - 1]);

/** A robot's word in the page's language. */
export const wordOf = (word) => words.word[word] ?? word;

/** A number of robots with this word: "2 need reset". */
export const countOf = (count, word) => `${count} ${words.counted[word]?.[count === 1 ? 0 : 1] ?? wordOf(word)}`;

/** All words, worst first. */
export const WORDS = Object.keys(EN.word);

/** The meaning of a reason; in English without a translation. */
export const meaningOf = (reason, means) => words.reason[reason]?.[0] ?? means ?? EN.reason[reason]?.[0] ?? reason;

/** The cure of a refused request; in the robot's words without a translation. */
export const cureOf = (reason, cure, robot) => (words.reason[reason]?.[1] ?? EN.reason[reason]?.[1] ?? cure).replaceAll("ROBOT", robot);

/** Meaning and cure of a reason why a robot does not move; in the desk's English without a translation. */
export function whyOf(reason, means, cure, robot) {
  const [ours, how] = words.of_robot[reason] ?? words.reason[reason] ?? [means, cure];
  return [ours, how.replaceAll("ROBOT", robot)];
}

/** A value of the chassis. */
export const valueOf = (value) => words.value[value] ?? value;

/** The text of a robot's row; in English without a translation of its reasons. */
export const textOf = (row) => (words === EN || row.reasons.length === 0 ? said(row.text) : row.reasons.map((one) => (words.of_robot[one] ?? [meaningOf(one)])[0]).join("；"));

/** A sentence of a robot or the desk in the page's language, as far as it is known. */
export function said(text) {
  if (words === EN || !text) return text;
  return sentence(text) ?? text.split("; ").map((part) => sentence(part) ?? part).join("；");
}

function sentence(text) {
  const reason = Object.keys(EN.reason).find((one) => one === text || EN.reason[one][0] === text);
  if (text in words.value || reason) return words.value[text] ?? meaningOf(reason);
  for (const [pattern, translated] of [...Object.values(words.event).flat(), ...words.said]) {
    const parts = pattern.exec(text);
    if (parts) return translated.replace(/\$(\d)|\{(\d)\}/g, (_, plain, told) => (plain ? parts[plain] : said(parts[told])));
  }
  // Reasons in a row, as of a reset.
  const all = text.split(", ");
  return all.length > 1 && all.every((one) => one in EN.reason) ? all.map((one) => meaningOf(one)).join("、") : null;
}

/** Store the desk's English meanings and cures. */
export function learnReasons(reasons) {
  EN.reason = reasons;
}

export function changeLanguage() {
  words = words === EN ? ZH : EN;
  localStorage.setItem("language", words === ZH ? "zh" : "en");
}

export const language = () => (words === ZH ? "zh" : "en");

/** The language of a sentence after `said`. */
export const languageOf = (text) => (said(text) === text ? "en" : language());
