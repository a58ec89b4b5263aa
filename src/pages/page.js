'use strict';
(() => {
  const $ = (pick, from = document) => from.querySelector(pick);
  const all = (pick, from = document) => [...from.querySelectorAll(pick)];
  const root = document.documentElement;

  // ---- theme: the link works without this; here nothing is loaded again
  const themes = ['system', 'dark', 'light'];
  const button = $('[data-theme-button]');
  const dress = (name) => {
    if (name === 'system') delete root.dataset.theme; else root.dataset.theme = name;
    document.cookie = `theme=${name}; Path=/; Max-Age=31536000; SameSite=Lax`;
    $('span', button).textContent = button.dataset.themeButton = name;
    const next = new URL(location.href);
    next.searchParams.set('theme', themes[(themes.indexOf(name) + 1) % 3]);
    button.href = next.pathname + next.search;
  };
  const turn = () => dress(themes[(themes.indexOf(button.dataset.themeButton) + 1) % 3]);
  if (button) button.addEventListener('click', (event) => { event.preventDefault(); turn(); });

  // ---- an analysis or the queue, followed
  const length = (s) => (s < 90 ? `${Math.round(s)} s` : s < 5400 ? `${Math.round(s / 60)} min` : `${(s / 3600).toFixed(1)} h`);
  const swap = async (pick) => {
    const answer = await fetch(location.href, { headers: { accept: 'text/html' } });
    if (!answer.ok) return;
    const page = new DOMParser().parseFromString(await answer.text(), 'text/html');
    for (const part of [pick, '.heading', '.top nav']) {
      const [now, then] = [$(part), $(part, page)];
      if (now && then) now.replaceWith(document.adoptNode(then));
    }
    figures();
  };
  const live = $('#live[data-events]');
  if (live) {
    const stream = new EventSource(live.dataset.events);
    const said = $('.live-said');
    let [spoken, drawn, status] = [0, 0, ''];
    const show = (event) => {
      const { status: now, progress } = JSON.parse(event.data);
      const isDone = ['succeeded', 'failed', 'cancelled'].includes(now);
      if (isDone || (status && now !== status)) {
        if (isDone) stream.close();
        status = now;
        swap('#live').then(() => { if (isDone && $('#live')) announce(`The analysis ${now}.`); });
        return;
      }
      status = now;
      if (Date.now() - drawn < 1000 || now !== 'running') return;
      drawn = Date.now();
      const share = Math.round(100 * progress.fraction);
      const bar = $('.live-bar');
      if (!$('progress', bar)) bar.innerHTML = '<progress max="100" aria-label="Progress"></progress> <span></span>';
      $('progress', bar).value = share;
      let words = `${share} %`;
      if (progress.eta_s != null) words += ` · ${length(progress.eta_s)} left`;
      if (progress.bracket) words += ` · gap ${(100 * progress.bracket.gap).toFixed(1)} %`;
      for (const old of all('.left, .gap', bar)) old.remove();
      $('span', bar).textContent = words;
      if (progress.phase) $('.live-phase').textContent = `at: ${progress.phase}`;
      const quarter = Math.floor(share / 25) * 25;
      if (quarter > spoken) { spoken = quarter; said.textContent = `${quarter} % done`; }
    };
    stream.addEventListener('status', show);
    stream.addEventListener('progress', show);
    stream.addEventListener('problem', () => { stream.close(); swap('#live'); });
    stream.onerror = () => {
      if (stream.readyState !== EventSource.CLOSED) said.textContent = 'The live view is interrupted; trying again.';
    };
    addEventListener('pagehide', () => stream.close());
  }
  const announce = (words) => {
    const place = document.createElement('p');
    place.className = 'hidden';
    place.setAttribute('role', 'status');
    $('main').append(place);
    setTimeout(() => { place.textContent = words; }, 50);
  };
  if ($('[data-live-queue]')) {
    const again = setInterval(async () => {
      if (document.hidden) return;
      await swap('[data-live-queue], .none');
      if (!$('[data-live-queue]')) clearInterval(again);
    }, 2500);
  }

  // ---- figures: drag to look closer; the address keeps what is seen
  const place = (svg, x) => {
    const [from, to] = [Number(svg.dataset.from), Number(svg.dataset.to)];
    return svg.dataset.scale === 'logarithmic' ? from * (to / from) ** x : from + (to - from) * x;
  };
  const share = (plot, event) => {
    const box = plot.getBoundingClientRect();
    return Math.min(1, Math.max(0, (event.clientX - box.left) / box.width));
  };
  const seen = (svg) => [Number(svg.dataset.from), Number(svg.dataset.to)];
  const draw = async (card, from, to) => {
    const shown = all('.plot > div', card).find((one) => one.offsetParent);
    const old = $('svg.fig', shown);
    const url = new URL(card.dataset.address, location.href);
    url.searchParams.set('theme', 'page');
    url.searchParams.set('w', String(Math.max(280, Math.round(old.viewBox.baseVal.width))));
    if (from != null) { url.searchParams.set('from', from); url.searchParams.set('to', to); }
    const answer = await fetch(url);
    if (!answer.ok) return;
    const text = await answer.text();
    const fresh = new DOMParser().parseFromString(text, 'image/svg+xml').documentElement;
    old.replaceWith(document.adoptNode(fresh));
    handle(card, fresh);
    if (card.contains(document.activeElement) || card.dataset.focus) fresh.focus();
  };
  const look = (card, from, to, keep = true) => {
    const digits = (value) => Number(value.toPrecision(6));
    const isWhole = from == null;
    if (!isWhole) [from, to] = [digits(from), digits(to)];
    const isMain = Boolean($('.zoom', card));
    if (isMain) {
      $('[name=from]', card).value = isWhole ? '' : from;
      $('[name=to]', card).value = isWhole ? '' : to;
      if (keep) {
        const url = new URL(location.href);
        for (const [name, value] of [['from', from], ['to', to]]) {
          if (isWhole) url.searchParams.delete(name); else url.searchParams.set(name, value);
        }
        history.pushState({ from, to }, '', url);
      }
      for (const link of all('[data-trial]')) {
        const url = new URL(link.href);
        url.search = location.search;
        link.href = url.pathname + url.search;
      }
    }
    return draw(card, isWhole ? null : from, to);
  };
  addEventListener('popstate', () => {
    const card = $('.zoom')?.closest('.figure');
    if (!card) return;
    const query = new URL(location.href).searchParams;
    const [from, to] = ['from', 'to'].map((name) => (query.has(name) ? Number(query.get(name)) : null));
    if (from == null || to == null) look(card, null, null, false); else look(card, from, to, false);
  });
  const handle = (card, svg) => {
    svg.setAttribute('tabindex', '0');
    let [band, began, plot] = [null, 0, null];
    svg.addEventListener('pointerdown', (event) => {
      plot = event.target.closest?.('.f-plot') || all('.f-plot', svg).find((one) => {
        const box = one.getBoundingClientRect();
        return event.clientX >= box.left && event.clientX <= box.right && event.clientY >= box.top && event.clientY <= box.bottom;
      });
      if (!plot || event.button) return;
      began = share(plot, event);
      svg.setPointerCapture(event.pointerId);
      band = document.createElementNS('http://www.w3.org/2000/svg', 'rect');
      band.setAttribute('class', 'zoom-band');
      band.setAttribute('height', plot.height.baseVal.value);
      plot.append(band);
    });
    svg.addEventListener('pointermove', (event) => {
      if (!band) return;
      const [a, b] = [began, share(plot, event)].sort((x, y) => x - y);
      const width = plot.width.baseVal.value;
      band.setAttribute('x', a * width);
      band.setAttribute('width', (b - a) * width);
    });
    svg.addEventListener('pointerup', (event) => {
      if (!band) return;
      band.remove();
      band = null;
      const [a, b] = [began, share(plot, event)].sort((x, y) => x - y);
      if (b - a > 0.01) look(card, place(svg, a), place(svg, b));
    });
    svg.addEventListener('dblclick', () => look(card, null, null));
    svg.addEventListener('keydown', (event) => {
      const [from, to] = seen(svg);
      const steps = { '+': [0.25, 0.75], '-': [-0.5, 1.5], ArrowLeft: [-0.25, 0.75], ArrowRight: [0.25, 1.25] };
      if (event.key === '0') look(card, null, null);
      else if (steps[event.key] && to > from) look(card, ...steps[event.key].map((x) => place(svg, x)));
      else return;
      event.preventDefault();
      event.stopPropagation();
    });
  };
  const figures = () => {
    for (const card of all('.figure[data-address]')) for (const svg of all('svg.fig', card)) handle(card, svg);
  };
  figures();

  // ---- files dropped on their area are sent at once
  const drop = $('[data-drop]');
  if (drop) {
    const input = $('input', drop);
    for (const name of ['dragover', 'dragleave', 'drop']) {
      drop.addEventListener(name, (event) => {
        event.preventDefault();
        drop.classList.toggle('over', name === 'dragover');
        if (name !== 'drop' || !event.dataTransfer.files.length) return;
        input.files = event.dataTransfer.files;
        input.form.requestSubmit();
      });
    }
  }

  // ---- keys
  const keys = $('.keys');
  const isOn = () => localStorage.getItem('keys') !== 'off';
  const list = [['g h', 'studies'], ['g q', 'queue'], ['g u', 'upload'], ['j k', 'next and previous row'], ['Enter', 'open the row'], ['[ ]', 'trial before and after'], ['t', 'theme'], ['+ − 0 ← →', 'in a figure: closer, wider, whole, left, right'], ['?', 'these keys'], ['Esc', 'close']];
  const dialog = document.createElement('dialog');
  const help = document.createElement('dl');
  for (const [key, what] of list) {
    for (const [tag, words] of [['dt', key], ['dd', what]]) {
      const one = document.createElement(tag);
      one.textContent = words;
      help.append(one);
    }
  }
  const heading = document.createElement('h2');
  heading.textContent = 'Keys';
  heading.id = 'keys';
  dialog.setAttribute('aria-labelledby', 'keys');
  const close = document.createElement('button');
  close.textContent = 'Close';
  close.addEventListener('click', () => dialog.close());
  dialog.append(heading, help, close);
  document.body.append(dialog);
  if (keys) {
    keys.hidden = false;
    const toggle = $('[data-keys=switch]', keys);
    const say = () => {
      toggle.setAttribute('aria-pressed', String(isOn()));
      toggle.textContent = isOn() ? 'Keys are on' : 'Keys are off';
    };
    say();
    toggle.addEventListener('click', () => { localStorage.setItem('keys', isOn() ? 'off' : 'on'); say(); });
    $('[data-keys=list]', keys).addEventListener('click', () => dialog.showModal());
  }
  let [before, row] = ['', -1];
  const step = (by) => {
    const rows = all('main tbody tr').filter((one) => $('a', one));
    if (!rows.length) return;
    rows[row]?.classList.remove('here');
    row = Math.min(rows.length - 1, Math.max(0, row + by));
    rows[row].classList.add('here');
    $('a', rows[row]).focus();
  };
  addEventListener('keydown', (event) => {
    const isTyping = event.target.closest?.('input, textarea, select, [contenteditable]');
    if (!isOn() || isTyping || event.ctrlKey || event.metaKey || event.altKey || dialog.open) return;
    const go = { h: '/', s: '/', q: '/queue', u: '/upload' };
    const last = before;
    before = event.key;
    if (last === 'g' && go[event.key]) location.href = go[event.key];
    else if (event.key === 't' && button) turn();
    else if (event.key === 'j') step(1);
    else if (event.key === 'k') step(-1);
    else if (event.key === '?') dialog.showModal();
    else if (event.key === '[') $('[data-trial=before]')?.click();
    else if (event.key === ']') $('[data-trial=after]')?.click();
    else return;
    event.preventDefault();
  });
})();
